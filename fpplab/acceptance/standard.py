"""The standards of an acceptance test and what is permitted: the file `standard_*.yaml`."""

from __future__ import annotations

from collections.abc import Iterable
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
"""Sessions are called like it."""

QUANTITIES = {
    "PF": "Probing error, form",
    "PS": "Probing error, size",
    "SD": "Sphere-spacing error",
    "F": "Flatness measurement error",
}


class BallBarStandard(Document):
    """A ball bar as its certificate says; uncertainties are expanded ones, k = 2.

    form_um: how far the spheres are from round.
    """

    diameters_mm: tuple[Length, Length]
    spacing_mm: Length
    diameter_known_to_um: Micrometres = 0.0
    spacing_known_to_um: Micrometres = 0.0
    form_um: Micrometres = 0.0

    @model_validator(mode="after")
    def _spheres_stand_apart(self) -> BallBarStandard:
        least = sum(self.diameters_mm) / 2
        if self.spacing_mm <= least:
            raise ValueError(
                f"'spacing_mm' is {self.spacing_mm:g}: must exceed {least:g}, where the spheres touch"
            )
        small, large = sorted(self.diameters_mm)
        if large > 1.1 * small:
            raise ValueError(
                f"'diameters_mm' are {[*self.diameters_mm]}: must differ by no more than a tenth"
            )
        return self


class PlaneStandard(Document):
    """A plane as its certificate says. flatness_um: how far it is from flat."""

    size_mm: tuple[Length, Length]
    flatness_um: Micrometres = 0.0


class EvaluationRules(Document):
    """Which points count.

    cap_deg: greatest angle of incidence of the camera's ray on a sphere. edge_mm: width left out along
    silhouettes and edges, where a pixel sees two surfaces. least_points: of a sphere or plane.
    least_solid_angle_sr: of a sphere's measured cap. least_area_share: of a plane's size.
    """

    cap_deg: Annotated[float, Field(ge=20, le=80)] = 60.0
    edge_mm: Annotated[float, Field(ge=0, le=100)] = 1.0
    least_points: Annotated[int, Field(ge=50)] = 500
    least_solid_angle_sr: Annotated[float, Field(ge=0.1, le=5.2)] = 1.5
    least_area_share: Annotated[float, Field(gt=0, le=1)] = 0.5


class Permissible(Document):
    """Maximum permissible errors in µm; a quantity without one is reported and not judged."""

    PF: Permitted | None = None
    PS: Permitted | None = None
    SD: Permitted | None = None
    F: Permitted | None = None


class StandardItems(Document):
    """What a rig's fixture calls the standard in each of its positions."""

    ball_bar: tuple[ItemName, ...] = ()
    plane: tuple[ItemName, ...] = ()

    @model_validator(mode="after")
    def _every_position_is_another(self) -> StandardItems:
        names = [*self.ball_bar, *self.plane]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"'{name}' is named twice: each item is one position")
        return self


class Standard(Document):
    """The file: what the standards are, which points count, what is permitted."""

    name: Name
    ball_bar: BallBarStandard | None = None
    plane: PlaneStandard | None = None
    evaluation: EvaluationRules = EvaluationRules()
    mpe_um: Permissible = Permissible()
    items: StandardItems = StandardItems()

    @model_validator(mode="after")
    def _describes_what_it_is_asked_for(self) -> Standard:
        if self.ball_bar is None and self.plane is None:
            raise ValueError("neither 'ball_bar' nor 'plane' is given: describe at least one standard")
        for field in ("ball_bar", "plane"):
            if getattr(self.items, field) and getattr(self, field) is None:
                raise ValueError(f"'items.{field}' is given, but '{field}' is not described")
        for name in QUANTITIES:
            permitted, known = self.permitted_um(name), self.known_to_um(name)
            if permitted is not None and permitted <= known:
                raise ValueError(
                    f"'mpe_um.{name}' is {permitted:g}: must exceed {known:g}, to which the standard is "
                    "known, for nothing could pass"
                )
        return self

    @classmethod
    def load(cls, name: str | Path) -> Standard:
        """Read by path, or by name among those that come with fpplab. Raises `ConfigError`."""
        return config.load_document(config.find_config(name), cls)

    def permitted_um(self, quantity: str) -> float | None:
        """The maximum permissible error, None where none is stated."""
        return getattr(self.mpe_um, quantity)  # type: ignore[no-any-return]

    def known_to_um(self, quantity: str) -> float:
        """How well the standard itself is known: what an error must stay inside its limit by."""
        bar, plane = self.ball_bar, self.plane
        if quantity == "F":
            return plane.flatness_um if plane else 0.0
        fields = {"PF": "form_um", "PS": "diameter_known_to_um", "SD": "spacing_known_to_um"}
        return float(getattr(bar, fields[quantity])) if bar else 0.0

    def permitting(self, assignments: Iterable[str]) -> Standard:
        """The same with limits in µm such as "PF=50" in place of its own. Raises `ConfigError`."""
        limits = self.mpe_um.model_dump()
        for assignment in assignments:
            quantity, _, value = assignment.partition("=")
            if quantity.strip() not in QUANTITIES:
                raise ConfigError(
                    f"--mpe: '{assignment}' must be one of {', '.join(QUANTITIES)}, =, and µm: PF=50"
                )
            try:
                limits[quantity.strip()] = float(value)
            except ValueError:
                raise ConfigError(f"--mpe: '{assignment}' has no number after =, such as PF=50") from None
        plain = {**config.plain(self), "mpe_um": limits}
        return config.validate(plain, Standard, "--mpe")
