"""Images: how many a measurement takes."""

from __future__ import annotations

from typing_extensions import override

from fpplab.optimisation.figures import MeasuredCandidate
from fpplab.optimisation.objective import Objective


class Images(Objective):
    """Number of images; a study limits it before anything is measured, by `constraints.images`."""

    key = "images"
    title = "Images"
    sentence = "number of images that a measurement takes"
    number_format = "d"
    is_integer = True

    @override
    def value(self, candidate: MeasuredCandidate) -> float:
        return candidate.figures.images
