"""What is said of coordinates that neighbours unwrapped: which islands have a known fringe order."""

import numpy as np
from numpy.typing import NDArray

from fpplab.phase import Decoded

INVISIBLE_STEP = (
    "islands: a step of a whole number of periods along all of an edge looks like none in one set of fringes"
)

ONE_FRAME = (
    "one frame: in which direction the phase rises, which is taken to be along the camera's axis, and "
    "everything that only several images of a set show"
)
PLANE = "plane: that distance, baseline, period and plates are as stated, and that nothing moved between"


def describe_heights(decoded: Decoded) -> str | None:
    """Say how many heights there are, and how uncertain; None without a reference plane."""
    if decoded.height_mm is None or decoded.sigma_height_mm is None:
        return None
    known = np.isfinite(decoded.height_mm)
    if not known.any():
        return "no pixel has a height over the plane"
    sigma_um = 1e3 * float(np.median(decoded.sigma_height_mm[known]))
    return f"{np.count_nonzero(known)} pixels have a height over the plane, with a sigma of {sigma_um:.3g} µm"


def describe_resolution(decoded: Decoded) -> str | None:
    """Say what one frame does not show; None where every pixel is measured by itself."""
    if decoded.resolution_px is None:
        return None
    return (
        f"one frame shows nothing narrower than {decoded.resolution_px:.0f} px, and neighbours within share "
        "their noise"
    )


def island_counts(decoded: Decoded) -> dict[str, int] | None:
    """Count the islands, and those whose order is known; None where no neighbours unwrapped."""
    if decoded.island is None:
        return None
    numbers = np.unique(decoded.island[decoded.island != 0])
    return {"count": len(numbers), "known": int((numbers > 0).sum())}


def describe_unknown_orders(island: NDArray[np.int32]) -> str | None:
    """Say what is unknown of the islands' orders; None where all are known."""
    numbers = np.unique(island[island != 0])
    if len(numbers) == 0:
        return "neighbours form no connected surface"
    unknown = numbers[numbers < 0]
    if len(unknown) == 0:
        return None
    share = np.count_nonzero(island < 0) / np.count_nonzero(island)
    islands = "1 island" if len(numbers) == 1 else f"{len(numbers)} islands"
    text = f"{len(unknown)} of {islands}, with {share:.0%} of the pixels, have an unknown fringe order"
    if len(numbers) > 1:
        text += ", so that heights between them are unknown"
    return f"{text}; a narrower range of depths, or a point of each by --known, determines them"
