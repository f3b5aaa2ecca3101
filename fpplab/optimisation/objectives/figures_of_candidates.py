"""Objectives that are among the figures of every candidate."""

from typing import Annotated

from pydantic import Field
from typing_extensions import override

from fpplab.core.config import Positive
from fpplab.optimisation.candidate import MeasuredCandidate
from fpplab.optimisation.objective import Objective, ObjectiveLimit


class Completeness(Objective):
    """Share of the true surface that is measured."""

    key = "completeness"
    title = "Completeness"
    sentence = "share of the true surface that has a measured point nearby"
    number_format = ".4f"
    is_maximised = True
    limit = ObjectiveLimit(
        "completeness_of_start",
        Annotated[float, Field(ge=0, le=1)],
        0.95,
        "Least completeness, as a multiple of the start's.",
    )

    @override
    def excess(self, value: float, of_start: float, limit: float) -> float:
        return limit * of_start - value


class Images(Objective):
    """Number of images; a study limits it before anything is measured, by `constraints.images`."""

    key = "images"
    title = "Images"
    sentence = "number of images that a measurement takes"
    number_format = "d"
    is_integer = True


class Seconds(Objective):
    """Acquisition time of a measurement."""

    key = "seconds"
    title = "Acquisition time"
    unit = "s"
    sentence = "acquisition time of a measurement on projector and camera"
    limit = ObjectiveLimit("seconds", Positive | None, None, "Longest acquisition time.")

    @override
    def excess(self, value: float, of_start: float, limit: float) -> float:
        return value / limit - 1.0


class SurfaceRms(Objective):
    """Root mean square distance of the points from the true surface."""

    key = "surface_rms_um"
    title = "Surface RMS"
    unit = "µm"
    sentence = "root mean square distance of the points from the true surface"


class SurfaceSmcd(Objective):
    """Symmetric mean distance between points and true surface."""

    key = "surface_smcd_um"
    title = "Surface SMCD"
    unit = "µm"
    sentence = "symmetric mean distance between points and true surface"
    limit = ObjectiveLimit(
        "smcd_of_start",
        Positive | None,
        None,
        "Greatest mean distance to the surface, as a multiple of the start's.",
    )

    @override
    def spread(self, candidate: MeasuredCandidate) -> float | None:
        return candidate.figures.smcd_spread_um

    @override
    def excess(self, value: float, of_start: float, limit: float) -> float:
        return value / (limit * of_start) - 1.0


class WorstSmcd(Objective):
    """Symmetric mean distance between points and true surface for the worst seed."""

    key = "worst_smcd_um"
    title = "Worst seed"
    unit = "µm"
    sentence = (
        "surface SMCD of the seed for which it is greatest; where every seed draws a matched twin within its "
        "uncertainty, that of the worst of these twins"
    )
