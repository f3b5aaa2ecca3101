"""What a search solves: what may vary and within which bounds, the limits of a plan, and the objectives."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field, GetPydanticSchema, WithJsonSchema, create_model, model_validator

from fpplab.core.config import Document, Positive
from fpplab.core.conventions import Axis
from fpplab.core.errors import ConfigError
from fpplab.optimisation import objectives  # noqa: F401 - defines the objectives
from fpplab.optimisation.objective import registered_objectives
from fpplab.patterns.fringe_sets import AnySet, PatternBits
from fpplab.patterns.plan import Plan

ANY_RIG = "any"  # value of `SearchProblem.rig` for a study that suits any rig

_OBJECTIVES = registered_objectives()


def _check_objective(key: str) -> str:
    if key not in _OBJECTIVES:
        raise ValueError(f"must be one of {', '.join(_OBJECTIVES)}")
    return key


ObjectiveKey = Annotated[
    str, AfterValidator(_check_objective), WithJsonSchema({"type": "string", "enum": list(_OBJECTIVES)})
]
"""Key of an objective."""

StepRange = tuple[Annotated[int, Field(ge=3, le=1000)], Annotated[int, Field(ge=3, le=1000)]]
Positives = tuple[Positive, Positive]
Range = tuple[float, float]


OF_ALL_SETS = ("exposure_s", "pattern_bits", "stage_mm", "convergence_deg")  # parameters beside the sets' own


Ranges = tuple[dict[str, Range] | None, ...]


class Alternative(Document):
    """Sets of patterns of any kind that a candidate may show in place of the start's."""

    fringes: Annotated[tuple[AnySet, ...], Field(min_length=1, max_length=8)]
    """The sets, as in a plan file; all else is as in the start's plan."""
    ranges: Ranges = ()
    """Bounds of numbers of each set, by the names of its fields, such as `{bits: [6, 8]}`; null where all are
    kept."""
    exposures_s: Annotated[tuple[Positive, ...] | None, Field(min_length=2, max_length=8)] = None
    """Exposures of every image, in place of the start's and of the one that is searched."""


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
    ranges: Ranges = ()
    """Bounds of further numbers of each set, by the names of its fields, such as `{cell_px: [4, 16]}`."""
    alternatives: tuple[Alternative, ...] = ()
    """Other sets to choose from, of any kind, each with its own bounds."""
    axis: tuple[Axis, ...] = ()
    """Fringe directions to choose from."""
    exposure_s: Positives | None = None
    """Exposure of every image in seconds."""
    pattern_bits: tuple[PatternBits, PatternBits] | None = None
    """Bits in which every image is projected: fewer allow shorter exposures, and are dithered."""
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

    def ranges_of_arrangements(self) -> list[tuple[str, Ranges]]:
        """Further ranges of the start's sets, then those of the alternatives', with the prefix of names."""
        others = ((f"alternatives[{k}].", each.ranges) for k, each in enumerate(self.alternatives))
        return [("", self.ranges), *others]

    def bounds(self) -> list[tuple[str, tuple[float, float]]]:
        # returns (float, float)
        named: list[tuple[str, tuple[float, float] | None]] = [("sets", self.sets)]
        named += [(f"steps[{i}]", bounds) for i, bounds in enumerate(self.steps)]
        named += [(f"stripes[{i}]", bounds) for i, bounds in enumerate(self.stripes)]
        for prefix, ranges in self.ranges_of_arrangements():
            named += [
                (f"{prefix}{name}[{i}]", bounds)
                for i, own in enumerate(ranges)
                for name, bounds in (own or {}).items()
            ]
        named += [(name, getattr(self, name)) for name in OF_ALL_SETS]
        return [(name, bounds) for name, bounds in named if bounds is not None]


class PlanConstraints(Document):
    """Limits that a plan has to keep to be accepted."""

    pixels_per_period: Annotated[float, Field(ge=2)] = 4.0
    """Least length of a fringe period in projector pixels."""
    images: Annotated[int, Field(ge=3)] | None = None
    """Greatest number of images."""
    wrong_orders: Annotated[float, Field(ge=0, le=1)] = 0.001
    """Greatest share of points with a wrong fringe order; that of the start if it is greater."""


_LIMITS = [objective.limit for objective in _OBJECTIVES.values() if objective.limit is not None]
_FIELDS: dict[str, Any] = {
    limit.key: (limit.type, Field(limit.default, description=limit.description)) for limit in _LIMITS
}
Constraints: type[PlanConstraints] = create_model(
    "Constraints", __base__=PlanConstraints, __module__=__name__, __doc__=PlanConstraints.__doc__, **_FIELDS
)
"""`PlanConstraints` with the limits that the objectives bring."""


class CalibrationAt(Document):
    """A calibration of the rig with its stage at a position."""

    file: str
    """Calibration file; a relative path refers to the study's folder."""
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


class SearchProblem(Document):
    """What a search solves: what may vary, the limits, and the objectives."""

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
    constraints: Annotated[PlanConstraints, GetPydanticSchema(lambda _, handler: handler(Constraints))] = (
        Constraints()
    )
    """Limits that a plan has to keep."""
    objectives: Annotated[
        tuple[ObjectiveKey, ...],
        Field(
            min_length=1,
            description="What is optimised; several objectives need a method that finds a Pareto front. "
            + "; ".join(f"`{key}`: {objective.sentence}" for key, objective in _OBJECTIVES.items()),
        ),
    ]
    seeds: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1)] = (1, 2, 3)
    """Seeds of the noise, the same for every candidate; on a real rig, as many repeats."""
    budget: Annotated[int, Field(ge=1)] = 400
    """Greatest number of candidates measured."""
    screening: bool = False
    """Whether candidates are predicted from bands of rows, and only the start and what was found
    are measured, with other seeds; on a simulation that can do so, where `space` moves nothing.
    """

    @model_validator(mode="after")
    def _named_once(self) -> SearchProblem:
        for name in ("artefacts", "objectives", "seeds"):
            values = getattr(self, name)
            if len(set(values)) < len(values):
                raise ValueError(f"'{name}' is {list(values)}: names one twice")
        return self

    def check_rig(self, name: str, source: Path | str) -> None:
        if self.rig not in (ANY_RIG, name):
            raise ConfigError(
                f"{source}: 'rig' is '{self.rig}', but the rig given is '{name}'; name that one, or `any`"
            )
