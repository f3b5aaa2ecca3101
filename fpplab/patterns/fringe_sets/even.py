"""Even light: white, black or grey images, which tell a pixel's brightest and darkest levels."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from fpplab.core.conventions import Axis, Floats
from fpplab.patterns.fringe_sets.base import LedName, PatternSet


class Even(PatternSet):
    """Images of the same light everywhere, one for each level, such as white and black."""

    kind: Literal["even"] = "even"
    """`even`."""

    led: LedName | None = None
    """The one LED that lights the images; by default all that are on. White under red, green and blue alone
    gives points their colours where the camera sees none."""
    levels: Annotated[tuple[Annotated[float, Field(ge=0, le=1)], ...], Field(min_length=1, max_length=256)]
    """Light of each image: 1 is white, 0 is black."""

    @classmethod
    def guessed(
        cls, images: Sequence[NDArray[np.bool_]], edges: Sequence[int], axis: Axis | None, length: int
    ) -> dict[str, Any] | None:
        """Take images without an axis for white and black."""
        return {"levels": tuple(float(image.mean() > 0.5) for image in images)} if axis is None else None

    @property
    def images(self) -> int:
        return len(self.levels)

    @property
    def one_led(self) -> LedName | None:
        return self.led

    def light(self, step: int, coordinate: Floats, length: int) -> Floats:
        """Give the level of the image everywhere."""
        return np.full(np.shape(coordinate), self.levels[step])

    def finest_stripes(self, length: int) -> float:
        """Give 0: it has no pattern."""
        return 0.0

    @property
    def short_name(self) -> str:
        return "even"
