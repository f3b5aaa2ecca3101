"""Ranges that several sections of a world file share."""

from typing import Annotated

from pydantic import Field

NotNegative = Annotated[float, Field(ge=0)]  # a number of at least 0
Share = Annotated[float, Field(ge=0, le=1)]  # a number from 0 to 1
PixelSize = tuple[Annotated[int, Field(ge=8, le=20000)], Annotated[int, Field(ge=8, le=20000)]]
"""(width, height) in pixels or mirrors."""
