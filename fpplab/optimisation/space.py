"""The search space: parameters with their ranges, points, and the candidates that they stand for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from pydantic import ValidationError

from fpplab.core.config import describe
from fpplab.core.conventions import axis_length
from fpplab.core.errors import ConfigError
from fpplab.optimisation.candidate import Candidate, Point
from fpplab.optimisation.limits import RigLimits
from fpplab.optimisation.problem import Range, SearchProblem
from fpplab.optimisation.scope import ParameterGroup
from fpplab.patterns.fringe_sets import MAX_PATTERN_BITS, FringeSet, PatternSet
from fpplab.patterns.plan import Plan
from fpplab.patterns.unwrapping import unwrapping_methods
from fpplab.phase import check_codes, check_unwrapping

DECIMALS = {"exposure_s": 6}
"""Decimals to which values are rounded, to keep plans readable, where they are not 3."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a search."""

    name: str  # as in a study file, for example "stripes[1]"
    group: ParameterGroup  # what it belongs to
    lower: float  # least value, in the parameter's unit
    upper: float  # greatest value
    is_integer: bool = False  # whether only integers are allowed
    is_logarithmic: bool = False  # whether equal ratios of values count as equal distances
    grid_step: float | None = None  # distance between allowed values
    place: tuple[int, int] | None = None  # arrangement and set in it that it is a number of

    @property
    def field(self) -> str:
        """What a set or a candidate calls it."""
        return self.name.rpartition(".")[2].partition("[")[0]

    def fraction(self, value: float) -> float:
        if self.upper == self.lower:
            return 0.0
        if self.is_logarithmic:
            return math.log(value / self.lower) / math.log(self.upper / self.lower)
        return (value - self.lower) / (self.upper - self.lower)

    def value_at(self, fraction: float) -> float:
        if self.is_logarithmic:
            value = self.lower * (self.upper / self.lower) ** fraction
        else:
            value = self.lower + fraction * (self.upper - self.lower)
        return self.rounded(value)

    def rounded(self, value: float) -> float:
        if self.is_integer:
            return float(round(value))
        if self.grid_step is not None:
            value = self.lower + self.grid_step * round((value - self.lower) / self.grid_step)
        tidy = round(value, DECIMALS.get(self.field, 3))
        return min(max(tidy, self.lower), self.upper)  # rounding alone must not leave the range

    def contains(self, value: float) -> bool:
        return self.lower <= value <= self.upper


@dataclass(frozen=True)
class SearchSpace:
    """The parameters of a study on a rig."""

    problem: SearchProblem  # what is searched
    limits: RigLimits  # limits of the rig
    parameters: tuple[Parameter, ...]  # those whose range is more than one value
    template: Candidate  # the start with as many fringe sets as the study allows at most
    arrangements: tuple[tuple[PatternSet, ...], ...]  # the template's sets, then the alternatives
    start: Point  # where the search begins

    @classmethod
    def of(cls, problem: SearchProblem, limits: RigLimits, source: str) -> SearchSpace:
        template = _template_candidate(problem, source)
        arrangements = template.fringes, *(each.fringes for each in problem.space.alternatives)
        parameters = tuple(p for p in _parameters(problem, arrangements, source) if p.lower < p.upper)
        if not parameters:
            raise ConfigError(f"{source}: 'space' leaves nothing to search; name a parameter and its bounds")
        start = tuple(_start_value(p, problem, template, arrangements, source) for p in parameters)
        space = cls(problem, limits, parameters, template, arrangements, start)
        _check_bounds(space, source)
        return space

    def candidate(self, point: Point) -> Candidate:
        values = {p.name: v for p, v in zip(self.parameters, point, strict=True)}
        template, chosen = self.template, int(values.get("alternative", 0))
        sets = [
            _with_values(each, (chosen, i), values, self.parameters)
            for i, each in enumerate(self.arrangements[chosen])
        ]
        if chosen == 0:
            if "axis" in values:
                axis = self.problem.space.axis[int(values["axis"])]
                sets = [each.model_copy(update={"axis": axis}) for each in sets]
            count = int(values.get("sets", len(sets)))
            sets = sets[:1] + sets[len(sets) - count + 1 :]
        several = self.problem.space.alternatives[chosen - 1].exposures_s if chosen else None
        if several:  # then the single one is not used, and must make no other candidate
            values["exposure_s"] = template.exposure_s
        return Candidate(
            fringes=tuple(sets),
            exposure_s=values.get("exposure_s", template.exposure_s),
            stage_mm=values.get("stage_mm", template.stage_mm),
            convergence_deg=values.get("convergence_deg", template.convergence_deg),
            exposures_s=several or template.exposures_s,
        )

    def with_alternative(self, k: int, point: Point | None = None) -> Point:
        """The start, or a point, with other sets: those of alternative k, counted from 1."""
        values = zip(self.parameters, point or self.start, strict=True)
        return tuple(float(k) if p.name == "alternative" else v for p, v in values)

    def refusal(self, candidate: Candidate) -> str | None:
        return next(self._refusals(candidate), None)

    def _refusals(self, candidate: Candidate) -> Iterator[str]:
        constraints = self.problem.constraints
        for axis in ("x", "y"):
            stripes = [f.stripes for f in candidate.fringes if isinstance(f, FringeSet) and f.axis == axis]
            if any(finer <= coarser for coarser, finer in pairwise(stripes)):
                yield f"stripes along {axis} do not increase from set to set"
        for i, each in enumerate(candidate.fringes):
            if fault := each.fault(axis_length(self.limits.size, each.coded_axis or "x")):
                yield f"'fringes[{i}].{fault}"
        try:
            check_codes(candidate.plan(self.problem.start), self.limits.size, "the candidate")
        except ConfigError as error:
            yield str(error)
        if constraints.images is not None and candidate.images > constraints.images:
            yield f"more than {constraints.images} images"
        yield from self.limits.refusals(candidate, constraints.pixels_per_period)

    def of_group(self, *groups: ParameterGroup) -> tuple[int, ...]:
        return tuple(i for i, p in enumerate(self.parameters) if p.group in groups)


def _with_values(
    shown: PatternSet,
    place: tuple[int, int],
    values: Mapping[str, float],
    parameters: tuple[Parameter, ...],
) -> PatternSet:
    changed: dict[str, Any] = {
        p.field: int(values[p.name]) if p.is_integer else values[p.name]
        for p in parameters
        if p.place == place
    }
    if "pattern_bits" in values and (place[0] == 0 or shown.pattern_bits is None):
        bits = int(values["pattern_bits"])
        changed["pattern_bits"] = None if bits == MAX_PATTERN_BITS else bits
    return shown.model_copy(update=changed) if changed else shown


def _template_candidate(problem: SearchProblem, source: str) -> Candidate:
    plan, space = problem.start, problem.space
    sets = list(Candidate.of(plan).fringes)
    for name, checked in (("start", plan), *_alternative_plans(problem)):
        if fault := checked.guidance_fault():
            raise ConfigError(f"{source}: '{name}': {fault}")
        if not unwrapping_methods()[plan.unwrapping].guided:
            check_unwrapping(checked, source)  # a guided one is checked where the calibration is known
    searched = plan.axes if space.axis else plan.unwrapped_axes
    if (space.sets or space.axis) and len(searched) > 1:
        raise ConfigError(f"{source}: 'space' searches sets or axis, and 'start' has fringes along both axes")
    count = space.sets[1] if space.sets else len(sets)
    for name in ("steps", "stripes", "ranges"):
        bounds = len(getattr(space, name))
        if bounds not in (0, count):
            raise ConfigError(
                f"{source}: 'space.{name}' has {bounds} bounds for {count} sets; give each its own, or null"
            )
    for i in range(1, count - len(sets) + 1):
        sets.insert(i, _additional_set(problem, i, source))
    convergence_deg = 0.0 if space.convergence_deg is not None else None
    if space.exposure_s and plan.exposures_s:
        raise ConfigError(f"{source}: 'space' searches exposure_s, and 'start' has 'exposures_s'")
    return Candidate(tuple(sets), plan.exposure_s, plan.stage_mm, convergence_deg, plan.exposures_s)


def _alternative_plans(problem: SearchProblem) -> Iterator[tuple[str, Plan]]:
    for k, each in enumerate(problem.space.alternatives):
        yield f"space.alternatives[{k}]", problem.start.model_copy(update={"fringes": each.fringes})


def _additional_set(problem: SearchProblem, i: int, source: str) -> PatternSet:
    steps, stripes = ((*getattr(problem.space, name), None)[i] for name in ("steps", "stripes"))
    if steps is None or stripes is None:
        raise ConfigError(
            f"{source}: 'space.sets' allows more sets than 'start' has, so 'steps[{i}]' and 'stripes[{i}]' "
            "need bounds"
        )
    middle = {"stripes": math.sqrt(stripes[0] * stripes[1]), "steps": sum(steps) // 2}
    return problem.start.fringes[0].model_copy(update=middle)


def _parameters(
    problem: SearchProblem, arrangements: tuple[tuple[PatternSet, ...], ...], source: str
) -> Iterator[Parameter]:
    space = problem.space
    if space.sets:
        yield Parameter("sets", "steps", *space.sets, is_integer=True)
    steps = tuple(bounds and {"steps": bounds} for bounds in space.steps)
    yield from _set_parameters(0, arrangements[0], "", steps, source, "steps")
    stripes = tuple(bounds and {"stripes": bounds} for bounds in space.stripes)
    yield from _set_parameters(0, arrangements[0], "", stripes, source, "stripes")
    if space.axis:
        yield Parameter("axis", "stripes", 0, len(space.axis) - 1, is_integer=True)
    if space.alternatives:
        yield Parameter("alternative", "codes", 0, len(space.alternatives), is_integer=True)
    for number, (prefix, further) in enumerate(space.ranges_of_arrangements()):
        yield from _set_parameters(number, arrangements[number], prefix, further, source, "codes")
    if space.exposure_s:
        yield Parameter("exposure_s", "light", *space.exposure_s, is_logarithmic=True)
    if space.pattern_bits:
        yield Parameter("pattern_bits", "light", *space.pattern_bits, is_integer=True)
    if space.stage_mm:
        yield Parameter("stage_mm", "geometry", *space.stage_mm, grid_step=space.stage_every_mm)
    if space.convergence_deg:
        yield Parameter("convergence_deg", "geometry", *space.convergence_deg)


def _set_parameters(
    number: int,
    sets: tuple[PatternSet, ...],
    prefix: str,
    ranges: Sequence[Mapping[str, Range] | None],
    source: str,
    group: ParameterGroup,
) -> Iterator[Parameter]:
    if len(ranges) not in (0, len(sets)):
        raise ConfigError(
            f"{source}: 'space.{prefix}ranges' has {len(ranges)} entries for {len(sets)} sets; "
            "give each its own, or null"
        )
    for i, own in enumerate(ranges):
        for field, bounds in (own or {}).items():
            name, shown = f"{prefix}{field}[{i}]", sets[i]
            fields = type(shown).model_fields
            numbers = [key for key in fields if fields[key].annotation in (int, float)]
            if field not in numbers:
                raise ConfigError(
                    f"{source}: 'space.{name}' is no number of the set {shown.short_name}; "
                    f"it has {', '.join(numbers) or 'none'}"
                )
            whole = fields[field].annotation is int
            for bound in bounds:
                changed = {**dict(shown), field: int(bound) if whole and bound == int(bound) else bound}
                try:
                    type(shown)(**changed)
                except ValidationError as error:
                    raise ConfigError(f"{source}: 'space.{name}': {describe(error)}") from None
            yield Parameter(
                name,
                group,
                *bounds,
                is_integer=whole,
                is_logarithmic=not whole and bounds[0] > 0,
                place=(number, i),
            )


def _start_value(
    parameter: Parameter,
    problem: SearchProblem,
    template: Candidate,
    arrangements: tuple[tuple[PatternSet, ...], ...],
    source: str,
) -> float:
    name = parameter.name
    if parameter.place is not None:
        arrangement, i = parameter.place
        return float(getattr(arrangements[arrangement][i], parameter.field))
    if name in ("sets", "alternative"):
        return len(problem.start.sets) if name == "sets" else 0
    if name == "axis":
        axis, choice = template.fringes[0].coded_axis, problem.space.axis
        return choice.index(axis) if axis in choice else -1
    value = getattr(template, name)
    if value is None:
        raise ConfigError(f"{source}: 'space.{name}' is searched, and 'start' has no {name} to begin with")
    return float(value)


def _check_bounds(space: SearchSpace, source: str) -> None:
    problem, start = space.problem, space.start
    for parameter, value in zip(space.parameters, start, strict=True):
        if not parameter.contains(value):
            raise ConfigError(
                f"{source}: 'space.{parameter.name}' is [{parameter.lower:g}, {parameter.upper:g}]: it does "
                f"not hold the start's {value:g}"
            )
    _check_stripes(space, source)
    for k, (name, plan) in enumerate((("start", problem.start), *_alternative_plans(problem))):
        plan.check_projector(space.limits.size, f"{source}: '{name}'")
        space.limits.check(space.candidate(space.with_alternative(k)), f"{source}: '{name}'")
    for i, parameter in enumerate(space.parameters):
        for bound in (parameter.lower, parameter.upper):
            _check_rig_reach(space, i, bound, source)
    min_images, max_images = _fewest_images(space), problem.constraints.images
    if max_images is not None and min_images > max_images:
        raise ConfigError(
            f"{source}: 'constraints.images' is {max_images}, and 'space' has no plan of fewer than "
            f"{min_images}"
        )


def _check_stripes(space: SearchSpace, source: str) -> None:
    bounds = space.problem.space.stripes
    guided = unwrapping_methods()[space.problem.start.unwrapping].guided
    max_so_far: dict[str, float] = {}
    for i, fringe in enumerate(space.template.fringes):
        if not isinstance(fringe, FringeSet):
            continue
        searched = bounds[i] if bounds else None
        if searched and fringe.axis not in max_so_far and not guided:
            raise ConfigError(
                f"{source}: 'space.stripes[{i}]' is the base, which is held where 'unwrapping' is not "
                "'guided': write null"
            )
        lower, upper = searched or (fringe.stripes, fringe.stripes)
        if upper <= max_so_far.get(fringe.axis, 0.0):
            raise ConfigError(
                f"{source}: 'space.stripes[{i}]' ends at {upper:g}, and the set before begins at "
                f"{max_so_far[fringe.axis]:g}: stripes must increase from set to set"
            )
        max_so_far[fringe.axis] = max(lower, max_so_far.get(fringe.axis, 0.0))


def _check_rig_reach(space: SearchSpace, i: int, bound: float, source: str) -> None:
    names = [p.name for p in space.parameters]
    place = space.parameters[i].place
    point = list(space.start if place is None else space.with_alternative(place[0]))
    point[i] = bound
    if "sets" in names:
        point[names.index("sets")] = space.parameters[names.index("sets")].upper
    if names[i] == "exposure_s" and "pattern_bits" in names:  # the fewest bits allow the shortest exposure
        point[names.index("pattern_bits")] = space.parameters[names.index("pattern_bits")].lower
    for axis in range(len(space.problem.space.axis) or 1):
        if "axis" in names:
            point[names.index("axis")] = axis
        candidate = space.candidate(tuple(point))
        for reason in space.limits.refusals(candidate, space.problem.constraints.pixels_per_period):
            raise ConfigError(
                f"{source}: 'space.{names[i]}' reaches {bound:g}, beyond rig '{space.limits.name}': {reason}"
            )


def _fewest_images(space: SearchSpace) -> int:
    values = zip(space.parameters, space.start, strict=True)
    fewest = tuple(p.lower if p.place or p.name == "sets" else v for p, v in values)
    plans = (space.with_alternative(k, fewest) for k in range(len(space.arrangements)))
    return min(space.candidate(point).images for point in plans)
