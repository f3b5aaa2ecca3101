"""Reference standards of an acceptance test, and maximum permissible errors: the file `standard_*.yaml`."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.errors import ConfigError

Length = Annotated[float, Field(gt=0, le=10_000)]
Micrometres = Annotated[float, Field(ge=0, le=10_000)]
Permitted = Annotated[float, Field(gt=0, le=100_000)]
Name = Annotated[str, Field(min_length=1)]
ItemName = Annotated[str, Field(pattern=r"^\w[\w .-]*$")]
"""Name of an item in a fixture; its sessions get the same name."""

QUANTITIES = {
    "PF": "Probing error, form",
    "PS": "Probing error, size",
    "SD": "Sphere-spacing error",
    "F": "Flatness measurement error",
}


class BallBarStandard(Document):
    """A ball bar as its calibration certificate describes it; uncertainties are expanded ones, k = 2."""

    diameters_mm: tuple[Length, Length]
    """Calibrated diameters of the two spheres, in mm; they may differ by a tenth at most."""
    spacing_mm: Length
    """Calibrated distance between the spheres' centres, in mm."""
    diameter_known_to_um: Micrometres = 0.0
    """Expanded uncertainty of the diameters, in µm."""
    spacing_known_to_um: Micrometres = 0.0
    """Expanded uncertainty of the spacing, in µm."""
    form_um: Micrometres = 0.0
    """Form deviation of the spheres (out of roundness), in µm."""

    @model_validator(mode="after")
    def _spheres_stand_apart(self) -> BallBarStandard:
        min_spacing = sum(self.diameters_mm) / 2
        if self.spacing_mm <= min_spacing:
            raise ValueError(
                f"'spacing_mm' is {self.spacing_mm:g}: must exceed {min_spacing:g}, where the spheres touch"
            )
        small, large = sorted(self.diameters_mm)
        if large > 1.1 * small:
            raise ValueError(
                f"'diameters_mm' are {[*self.diameters_mm]}: must differ by no more than a tenth"
            )
        return self


class PlaneStandard(Document):
    """A plane as its calibration certificate describes it."""

    size_mm: tuple[Length, Length]
    """Length and width, in mm."""
    flatness_um: Micrometres = 0.0
    """Flatness deviation, in µm."""


class EvaluationRules(Document):
    """Which points are evaluated, and how much of a standard must be measured."""

    cap_deg: Annotated[float, Field(ge=20, le=80)] = 60.0
    """Greatest angle of incidence of the camera's ray on a sphere, in degrees."""
    edge_mm: Annotated[float, Field(ge=0, le=100)] = 1.0
    """Width left out along silhouettes and edges, where a pixel sees two surfaces, in mm."""
    least_points: Annotated[int, Field(ge=50)] = 500
    """Least number of points on a sphere or plane."""
    least_solid_angle_sr: Annotated[float, Field(ge=0.1, le=5.2)] = 1.5
    """Least solid angle of a sphere's measured cap, in sr."""
    least_area_share: Annotated[float, Field(gt=0, le=1)] = 0.5
    """Least measured area of a plane, as a share of its size."""


Count = Annotated[int, Field(ge=1, le=1000)]


class LeastPositions(Document):
    """How many positions, spread over the measuring volume, each quantity has to be measured in.

    The defaults are meant to be those of VDI/VDE 2634 part 2 and are not checked against its text
    (docs/decisions/comparison.md).
    """

    PF: Count = 10
    """Of a sphere, for the probing error of form; each sphere of each position of a ball bar is one."""
    PS: Count = 10
    """Of a sphere, for the probing error of size."""
    SD: Count = 7
    """Of the ball bar."""
    F: Count = 6
    """Of the plane."""


class Permissible(Document):
    """Maximum permissible errors in µm; a quantity without one is reported and not judged."""

    PF: Permitted | None = None
    """Of the probing error, form, in µm."""
    PS: Permitted | None = None
    """Of the probing error, size, in µm."""
    SD: Permitted | None = None
    """Of the sphere-spacing error, in µm."""
    F: Permitted | None = None
    """Of the flatness measurement error, in µm."""


class StandardItems(Document):
    """Names of the fixture's items that are the standard, one for each of its positions."""

    ball_bar: tuple[ItemName, ...] = ()
    """Items that are the ball bar."""
    plane: tuple[ItemName, ...] = ()
    """Items that are the plane."""

    @model_validator(mode="after")
    def _every_position_is_another(self) -> StandardItems:
        names = [*self.ball_bar, *self.plane]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"'{name}' is named twice: each item is one position")
        return self


class Standard(Document):
    """The file of a set of standards: certificates, evaluation rules and maximum permissible errors."""

    name: Name
    """Of the set of standards, for reports."""
    ball_bar: BallBarStandard | None = None
    """The ball bar, if there is one."""
    plane: PlaneStandard | None = None
    """The plane, if there is one."""
    evaluation: EvaluationRules = EvaluationRules()
    """Which points are evaluated."""
    positions: LeastPositions = LeastPositions()
    """How many positions each quantity has to be measured in."""
    mpe_um: Permissible = Permissible()
    """Maximum permissible errors, in µm."""
    items: StandardItems = StandardItems()
    """The fixture's items that are the standards."""

    @model_validator(mode="after")
    def _describes_what_it_is_asked_for(self) -> Standard:
        if self.ball_bar is None and self.plane is None:
            raise ValueError("neither 'ball_bar' nor 'plane' is given: describe at least one standard")
        for field in ("ball_bar", "plane"):
            if getattr(self.items, field) and getattr(self, field) is None:
                raise ValueError(f"'items.{field}' is given, but '{field}' is not described")
        for name in QUANTITIES:
            permitted, uncertainty = self.permitted_um(name), self.reference_uncertainty_um(name)
            if permitted is not None and permitted <= uncertainty:
                raise ValueError(
                    f"'mpe_um.{name}' is {permitted:g}: must exceed {uncertainty:g}, the standard's own "
                    "uncertainty, or no measurement could pass"
                )
        return self

    @classmethod
    def load(cls, name: str | Path) -> Standard:
        return config.load_document(config.find_config(name, "standard"), cls, "standard")

    def permitted_um(self, quantity: str) -> float | None:
        return getattr(self.mpe_um, quantity)  # type: ignore[no-any-return]

    def reference_uncertainty_um(self, quantity: str) -> float:
        """Look up the uncertainty of the standard itself, by which the permissible error is reduced."""
        bar, plane = self.ball_bar, self.plane
        if quantity == "F":
            return plane.flatness_um if plane else 0.0
        fields = {"PF": "form_um", "PS": "diameter_known_to_um", "SD": "spacing_known_to_um"}
        return float(getattr(bar, fields[quantity])) if bar else 0.0

    def with_mpe(self, assignments: Iterable[str]) -> Standard:
        limits = self.mpe_um.model_dump() | _by_quantity(assignments, "--mpe", "PF=50", float)
        return config.validate({**config.plain(self), "mpe_um": limits}, Standard, "--mpe")

    def with_positions(self, assignments: Iterable[str]) -> Standard:
        numbers = self.positions.model_dump() | _by_quantity(assignments, "--positions", "SD=5", int)
        return config.validate({**config.plain(self), "positions": numbers}, Standard, "--positions")


def _by_quantity(
    assignments: Iterable[str], option: str, example: str, number: Callable[[str], float]
) -> dict[str, float]:
    numbers = {}
    for assignment in assignments:
        quantity, _, value = assignment.partition("=")
        if quantity.strip() not in QUANTITIES:
            raise ConfigError(
                f"{option}: '{assignment}' must be one of {', '.join(QUANTITIES)}, =, and a number: {example}"
            )
        try:
            numbers[quantity.strip()] = number(value)
        except ValueError:
            kind = "whole number" if number is int else "number"
            raise ConfigError(f"{option}: '{assignment}' has no {kind} after =, such as {example}") from None
    return numbers
