"""A study: what to search, within which bounds, for which objectives, and how (study_*.yaml).

    name: Stripe counts
    rig: any
    artefacts: [pyramid, pillars, steps]
    start: plan_paper.yaml
    space: {stripes: [null, [2, 32], [16, 228]]}
    objectives: [surface_smcd_um]
    method: {kind: coordinate}

What `space` does not name is held as the start has it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from fpplab.core import config
from fpplab.core.config import Document
from fpplab.core.conventions import Axis
from fpplab.core.errors import ConfigError
from fpplab.core.kinds import ByKind, members_by_kind
from fpplab.optimisation import methods  # noqa: F401 - defines the members of SearchMethod
from fpplab.optimisation.search_method import SearchMethod
from fpplab.patterns.plan import Plan

ANY_RIG = "any"

Objective = Literal["surface_smcd_um", "worst_smcd_um", "surface_rms_um", "completeness", "images", "seconds"]
"""What a study may ask for: completeness the most, of all else the least."""

StepRange = tuple[Annotated[int, Field(ge=3, le=1000)], Annotated[int, Field(ge=3, le=1000)]]
Positive = Annotated[float, Field(gt=0)]
Positives = tuple[Positive, Positive]
Range = tuple[float, float]


class SpaceFile(Document):
    """Bounds [least, most] of what is searched.

    sets: how many fringe sets. steps, stripes: of each set, null where it is held; with `sets` as many as
    the most, and fewer sets are the base and the last ones. axis: those to choose from. stage_mm: the
    baseline; stage_every_mm: its positions from the least on, all if None: candidates at one position share
    what is rendered there. convergence_deg: turn of the projector towards the camera from how it stands.
    """

    sets: tuple[Annotated[int, Field(ge=1, le=8)], Annotated[int, Field(ge=1, le=8)]] | None = None
    steps: tuple[StepRange | None, ...] = ()
    stripes: tuple[Positives | None, ...] = ()
    axis: tuple[Axis, ...] = ()
    exposure_s: Positives | None = None
    stage_mm: Range | None = None
    stage_every_mm: Positive | None = None
    convergence_deg: Range | None = None

    @model_validator(mode="after")
    def _in_order(self) -> SpaceFile:
        for name, bounds in self.bounds():
            if not bounds[0] <= bounds[1]:
                raise ValueError(f"'{name}' is {list(bounds)}: the first must not exceed the second")
        if self.stage_every_mm and self.stage_mm is None:
            raise ValueError("'stage_every_mm' is given without 'stage_mm'")
        if len(set(self.axis)) < len(self.axis):
            raise ValueError(f"'axis' is {list(self.axis)}: names an axis twice")
        return self

    def bounds(self) -> list[tuple[str, tuple[float, float]]]:
        """Every [least, most] by its name in the file."""
        named: list[tuple[str, tuple[float, float] | None]] = [("sets", self.sets)]
        named += [(f"steps[{i}]", bounds) for i, bounds in enumerate(self.steps)]
        named += [(f"stripes[{i}]", bounds) for i, bounds in enumerate(self.stripes)]
        named += [(name, getattr(self, name)) for name in ("exposure_s", "stage_mm", "convergence_deg")]
        return [(name, bounds) for name, bounds in named if bounds is not None]


class Constraints(Document):
    """What a plan must keep to be wanted.

    pixels_per_period: least projector pixels under one fringe. images, seconds: the most. wrong_orders: most
    share of points a fringe or more off, or the start's where that is more. completeness_of_start,
    smcd_of_start: the least and the most, as multiples of what the start has.
    """

    pixels_per_period: Annotated[float, Field(ge=2)] = 4.0
    images: Annotated[int, Field(ge=3)] | None = None
    seconds: Positive | None = None
    wrong_orders: Annotated[float, Field(ge=0, le=1)] = 0.001
    completeness_of_start: Annotated[float, Field(ge=0, le=1)] = 0.95
    smcd_of_start: Positive | None = None


class CalibrationAt(Document):
    """A characterisation with the stage at a position, or as it stands."""

    file: str
    stage_mm: float | None = None


class Board(Document):
    """How a rig without calibrations is characterised: with which item of its fixture, in how many poses."""

    item: str = "board"
    target: str = "target_paper.yaml"
    plan: str = "plan_board.yaml"
    poses: Annotated[int, Field(ge=3)] = 12


class Study(Document):
    """Schema of a study file; `load` puts the start's plan in place of its name.

    rig: the name in the rig's file that the study is for, or `any`. artefacts: items of the rig's fixture.
    start: a plan file, or the plan itself. calibrations: of the rig; without, it is characterised first, with
    `board`.
    seeds: of the noise, the same for every candidate; as many repeats on a real rig. budget: most candidates
    measured.
    """

    name: str
    rig: str = ANY_RIG
    artefacts: Annotated[tuple[str, ...], Field(min_length=1)]
    start: Plan
    calibrations: tuple[CalibrationAt, ...] = ()
    board: Board = Board()
    space: SpaceFile
    constraints: Constraints = Constraints()
    objectives: Annotated[tuple[Objective, ...], Field(min_length=1)]
    seeds: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)] = (1, 2, 3)
    method: Annotated[SearchMethod, ByKind()]
    budget: Annotated[int, Field(ge=1)] = 400

    @model_validator(mode="after")
    def _named_once(self) -> Study:
        for name in ("artefacts", "objectives", "seeds"):
            values = getattr(self, name)
            if len(set(values)) < len(values):
                raise ValueError(f"'{name}' is {list(values)}: names one twice")
        return self

    @model_validator(mode="after")
    def _method_fits(self) -> Study:
        several = len(self.objectives) > 1
        if several != self.method.several_objectives:
            raise ValueError(
                f"'method.kind' is '{self.method.kind}': with {len(self.objectives)} of 'objectives' it "
                f"must be {_kinds(several)}"
            )
        return self

    @classmethod
    def load(cls, path: Path | str) -> Study:
        """Read a study file, by path or by the name of one that comes with fpplab."""
        found = config.find_config(path)
        data = config.parse_yaml(config.read_text(found), found)
        if isinstance(data, dict):
            data = _resolved(data, found.parent)
        return config.validate(data, cls, found)

    def check_rig(self, name: str, source: Path | str) -> None:
        """Refuse a study that is for another rig: `ConfigError`."""
        if self.rig not in (ANY_RIG, name):
            raise ConfigError(
                f"{source}: 'rig' is '{self.rig}', but the rig given is '{name}'; name that one, or `any`"
            )


def _kinds(several_objectives: bool) -> str:
    """The search methods for one objective, or for several, listed in words."""
    kinds = [
        kind
        for kind, member in members_by_kind(SearchMethod).items()
        if issubclass(member, SearchMethod) and member.several_objectives is several_objectives
    ]
    return " or ".join(filter(None, [", ".join(kinds[:-1]), kinds[-1]]))


def _resolved(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The study with its start's plan in place, and files by where they are."""
    data = dict(data)
    if isinstance(data.get("board"), dict):
        beside = {
            n: config.resolve_beside(v, folder) if n in ("target", "plan") else v
            for n, v in data["board"].items()
        }
        data["board"] = beside
    if isinstance(data.get("start"), str):
        data["start"] = Plan.load(config.resolve_beside(data["start"], folder)).model_dump(mode="json")
    if isinstance(data.get("calibrations"), list):
        data["calibrations"] = [
            {**one, "file": config.resolve_beside(one["file"], folder)}
            if isinstance(one, dict) and isinstance(one.get("file"), str)
            else one
            for one in data["calibrations"]
        ]
    return data
