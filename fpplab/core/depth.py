"""A range of distances from the camera, as plans and rig files state it."""

from dataclasses import dataclass
from typing import Annotated

from pydantic import AfterValidator, Field

DepthInterval = tuple[float, float]  # least and greatest distance from the camera along its axis, in mm

_Distance = Annotated[float, Field(gt=0, le=1e6)]


def _rising(depth_mm: DepthInterval) -> DepthInterval:
    if not depth_mm[0] < depth_mm[1]:
        raise ValueError("the first must be less than the second, both in mm")
    return depth_mm


DepthField = Annotated[tuple[_Distance, _Distance], AfterValidator(_rising)]


@dataclass(frozen=True)
class DepthRange:
    """A range of distances from the camera, and who has stated it."""

    mm: DepthInterval  # least and greatest distance along the camera's axis, in mm
    source: str  # for messages and reports: option, or file and field


def first_stated(*stated: tuple[DepthInterval | None, str]) -> DepthRange | None:
    return next((DepthRange(mm, source) for mm, source in stated if mm is not None), None)
