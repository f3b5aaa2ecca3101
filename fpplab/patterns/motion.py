"""How parts moved while a recording was taken, and what is known of the frames that stand in for it."""

from dataclasses import dataclass

from fpplab.core.conventions import Map


@dataclass(frozen=True)
class PartMotion:
    """A part that moved evenly while it was scanned."""

    moved_mm: tuple[float, float, float]  # from the first frame to the last, in the camera's frame
    sigma_mm: float  # standard uncertainty of what of it displaces the coordinate
    fringes: float  # by how many widths of the finest fringes it is displaced
    middle_px: tuple[int, int]  # column and row of its middle
    pixels: int
    error_px: float  # RMS error of the coordinate that the motion causes
    left_px: float  # the same once the motion is compensated
    is_compensated: bool


@dataclass(frozen=True, eq=False)
class Compensation:
    """Parts that moved, and the uncertainty of coordinates from frames as of parts at rest."""

    parts: tuple[PartMotion, ...]
    noise: Map  # (height, width) how many times greater the noise of the coordinate is than by even steps
    left_px: Map  # (height, width) RMS error of the coordinate that the motion leaves
