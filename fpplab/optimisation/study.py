"""Study files (study_*.yaml): what to search, within which bounds, for which objectives, and by which method.

    name: Stripe counts
    rig: any
    artefacts: [pyramid, pillars, steps]
    start: plan_paper.yaml
    space: {stripes: [null, [2, 32], [16, 228]]}
    objectives: [surface_smcd_um]
    method: {kind: coordinate}

What `space` does not name keeps its value at the start.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from fpplab.core import config
from fpplab.core.config import Document, Positive
from fpplab.core.conventions import Axis
from fpplab.core.errors import ConfigError
from fpplab.core.tagged_union import TaggedUnion, registered_types
from fpplab.optimisation import methods  # noqa: F401 - defines the members of SearchMethod
from fpplab.optimisation.search_method import SearchMethod
from fpplab.patterns.plan import Plan

ANY_RIG = "any"
"""Value of `Study.rig` for a study that suits any rig."""

Objective = Literal["surface_smcd_um", "worst_smcd_um", "surface_rms_um", "completeness", "images", "seconds"]
"""What a study may ask for: completeness is maximised, all others are minimised."""

StepRange = tuple[Annotated[int, Field(ge=3, le=1000)], Annotated[int, Field(ge=3, le=1000)]]
Positives = tuple[Positive, Positive]
Range = tuple[float, float]


class SpaceFile(Document):
    """Bounds [least, most] of what is searched."""

    sets: tuple[Annotated[int, Field(ge=1, le=8)], Annotated[int, Field(ge=1, le=8)]] | None = None
    """Number of fringe sets."""
    steps: tuple[StepRange | None, ...] = ()
    """Phase steps of each set, null where they are kept.

    With `sets`, as many entries as its greatest number; a plan of fewer sets has the base and the last ones.
    """
    stripes: tuple[Positives | None, ...] = ()
    """Stripe counts of each set, null where they are kept; entries as in `steps`."""
    axis: tuple[Axis, ...] = ()
    """Fringe directions to choose from."""
    exposure_s: Positives | None = None
    """Exposure of every image in seconds."""
    stage_mm: Range | None = None
    """Position of the stage in mm, which sets the baseline."""
    stage_every_mm: Positive | None = None
    """Distance in mm between the positions of the stage that are tried, from the least on; any if null.

    On a simulation, candidates at one position share what is rendered there.
    """
    convergence_deg: Range | None = None
    """Rotation of the projector towards the camera in degrees, relative to its given orientation."""

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
        """List every range that is given."""
        # returns (float, float)
        named: list[tuple[str, tuple[float, float] | None]] = [("sets", self.sets)]
        named += [(f"steps[{i}]", bounds) for i, bounds in enumerate(self.steps)]
        named += [(f"stripes[{i}]", bounds) for i, bounds in enumerate(self.stripes)]
        named += [(name, getattr(self, name)) for name in ("exposure_s", "stage_mm", "convergence_deg")]
        return [(name, bounds) for name, bounds in named if bounds is not None]


class Constraints(Document):
    """Limits that a plan has to keep to be accepted."""

    pixels_per_period: Annotated[float, Field(ge=2)] = 4.0
    """Least length of a fringe period in projector pixels."""
    images: Annotated[int, Field(ge=3)] | None = None
    """Greatest number of images."""
    seconds: Positive | None = None
    """Longest acquisition time."""
    wrong_orders: Annotated[float, Field(ge=0, le=1)] = 0.001
    """Greatest share of points with a wrong fringe order; that of the start if it is greater."""
    completeness_of_start: Annotated[float, Field(ge=0, le=1)] = 0.95
    """Least completeness, as a multiple of the start's."""
    smcd_of_start: Positive | None = None
    """Greatest mean distance to the surface, as a multiple of the start's."""


class CalibrationAt(Document):
    """A calibration of the rig with its stage at a position."""

    file: str
    """Calibration file; a relative path is looked up beside the study."""
    stage_mm: float | None = None
    """Position of the stage in mm; null for where it is."""


class Board(Document):
    """How a rig without calibrations is characterised before the search."""

    item: str = "board"
    """Item of the fixture that is the calibration board."""
    target: str = "target_paper.yaml"
    """File of the calibration board."""
    plan: str = "plan_board.yaml"
    """Plan with which the board is measured."""
    poses: Annotated[int, Field(ge=3)] = 12
    """Number of poses of the board."""


class Study(Document):
    """Schema of a study file; `load` replaces the name of the start's plan by the plan itself."""

    name: str
    """Name of the study in reports."""
    rig: str = ANY_RIG
    """Name, as in the rig's file, of the rig that the study is for; or `any`."""
    artefacts: Annotated[tuple[str, ...], Field(min_length=1)]
    """Items of the rig's fixture that are measured."""
    start: Plan
    """Where the search begins: a plan file, or the plan itself."""
    calibrations: tuple[CalibrationAt, ...] = ()
    """Calibrations of the rig; without them it is characterised first, with `board`."""
    board: Board = Board()
    """How the rig is characterised if it has to be."""
    space: SpaceFile
    """What is searched, within which bounds."""
    constraints: Constraints = Constraints()
    """Limits that a plan has to keep."""
    objectives: Annotated[tuple[Objective, ...], Field(min_length=1)]
    """What is optimised; several objectives need a method that finds a Pareto front."""
    seeds: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)] = (1, 2, 3)
    """Seeds of the noise, the same for every candidate; on a real rig, as many repeats."""
    method: Annotated[SearchMethod, TaggedUnion()]
    """How the space is searched: one of the methods in `fpplab.optimisation.methods`, chosen by `kind`."""
    budget: Annotated[int, Field(ge=1)] = 400
    """Greatest number of candidates measured."""
    screening: bool = False
    """Whether candidates are predicted from bands of rows, and only the start and what was found
    are measured, with other seeds; on a simulation that can do so, where `space` moves nothing.
    """

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
        """Read a study file."""
        found = config.find_config(path, "study")
        data = config.parse_yaml(config.read_text(found), found)
        if isinstance(data, dict):
            data = _resolved(data, found.parent)
        return config.validate(data, cls, found)

    def check_rig(self, name: str, source: Path | str) -> None:
        """Refuse to be used on a rig that the study is not for."""
        if self.rig not in (ANY_RIG, name):
            raise ConfigError(
                f"{source}: 'rig' is '{self.rig}', but the rig given is '{name}'; name that one, or `any`"
            )


def _kinds(several_objectives: bool) -> str:
    """List the search methods for one objective, or for several, in words."""
    kinds = [
        kind
        for kind, member in registered_types(SearchMethod).items()
        if issubclass(member, SearchMethod) and member.several_objectives is several_objectives
    ]
    return " or ".join(filter(None, [", ".join(kinds[:-1]), kinds[-1]]))


def _resolved(data: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Put the start's plan in place, and make the paths of files found beside the study absolute."""
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
