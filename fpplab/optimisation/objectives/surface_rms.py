"""Surface RMS: the root mean square distance of the points from the surface."""

from __future__ import annotations

from typing_extensions import override

from fpplab.optimisation.figures import MeasuredCandidate
from fpplab.optimisation.objective import Objective


class SurfaceRms(Objective):
    """Root mean square distance of the points from the true surface."""

    key = "surface_rms_um"
    title = "Surface RMS"
    unit = "µm"
    sentence = "root mean square distance of the points from the true surface"

    @override
    def value(self, candidate: MeasuredCandidate) -> float:
        return candidate.figures.surface_rms_um
