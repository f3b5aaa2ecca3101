"""The acceptance test of a measuring system on a ball bar and a plane, after VDI/VDE 2634 part 2."""

from fpplab.comparison.acceptance.fitting import fit_plane, fit_sphere, fit_without_worst
from fpplab.comparison.acceptance.results import (
    CONVENTIONS,
    VERDICTS,
    Acceptance,
    BallBarTest,
    MeasuredFeature,
    PlaneTest,
    SphereTest,
    shared_variance,
)
from fpplab.comparison.acceptance.standard import QUANTITIES, Standard
from fpplab.comparison.acceptance.verification import verify, verify_ball_bar, verify_plane

__all__ = [
    "CONVENTIONS",
    "QUANTITIES",
    "VERDICTS",
    "Acceptance",
    "BallBarTest",
    "MeasuredFeature",
    "PlaneTest",
    "SphereTest",
    "Standard",
    "fit_plane",
    "fit_sphere",
    "fit_without_worst",
    "shared_variance",
    "verify",
    "verify_ball_bar",
    "verify_plane",
]
