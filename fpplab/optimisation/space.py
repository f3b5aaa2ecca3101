"""The search space: parameters with their ranges, points, and the candidates that they stand for."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from itertools import pairwise

from fpplab.core.errors import ConfigError
from fpplab.optimisation.candidate import Candidate, Fringes, Point
from fpplab.optimisation.limits import RigLimits
from fpplab.optimisation.problem import SearchProblem
from fpplab.optimisation.scope import ParameterGroup
from fpplab.patterns.fringe_sets import MAX_PATTERN_BITS, Sinusoid
from fpplab.patterns.unwrapping import unwrapping_methods
from fpplab.phase import check_unwrapping

DECIMALS = {"stripes": 3, "exposure_s": 6, "stage_mm": 3, "convergence_deg": 3}
"""Decimals to which values are rounded, to keep plans readable."""


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
        tidy = round(value, DECIMALS[self.name.partition("[")[0]])
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
    start: Point  # where the search begins

    @classmethod
    def of(cls, problem: SearchProblem, limits: RigLimits, source: str) -> SearchSpace:
        template = _template_candidate(problem, source)
        parameters = tuple(p for p in _parameters(problem) if p.lower < p.upper)
        if not parameters:
            raise ConfigError(f"{source}: 'space' leaves nothing to search; name a parameter and its bounds")
        start = tuple(_start_value(p.name, problem, template, source) for p in parameters)
        space = cls(problem, limits, parameters, template, start)
        _check_bounds(space, source)
        return space

    def candidate(self, point: Point) -> Candidate:
        values = {p.name: v for p, v in zip(self.parameters, point, strict=True)}
        template = self.template
        fringes = [
            replace(
                fringe,
                steps=int(values.get(f"steps[{i}]", fringe.steps)),
                stripes=values.get(f"stripes[{i}]", fringe.stripes),
                pattern_bits=_pattern_bits(values, fringe.pattern_bits),
            )
            for i, fringe in enumerate(template.fringes)
        ]
        if "axis" in values:
            axis = self.problem.space.axis[int(values["axis"])]
            fringes = [replace(fringe, axis=axis) for fringe in fringes]
        count = int(values.get("sets", len(fringes)))
        return Candidate(
            fringes=tuple(fringes[:1] + fringes[len(fringes) - count + 1 :]),
            exposure_s=values.get("exposure_s", template.exposure_s),
            stage_mm=values.get("stage_mm", template.stage_mm),
            convergence_deg=values.get("convergence_deg", template.convergence_deg),
            exposures_s=template.exposures_s,
        )

    def refusal(self, candidate: Candidate) -> str | None:
        return next(self._refusals(candidate), None)

    def _refusals(self, candidate: Candidate) -> Iterator[str]:
        constraints = self.problem.constraints
        for axis in ("x", "y"):
            stripes = [f.stripes for f in candidate.fringes if f.axis == axis]
            if any(finer <= coarser for coarser, finer in pairwise(stripes)):
                yield f"stripes along {axis} do not increase from set to set"
        if constraints.images is not None and candidate.images > constraints.images:
            yield f"more than {constraints.images} images"
        yield from self.limits.refusals(candidate, constraints.pixels_per_period)

    def of_group(self, *groups: ParameterGroup) -> tuple[int, ...]:
        return tuple(i for i, p in enumerate(self.parameters) if p.group in groups)


def _template_candidate(problem: SearchProblem, source: str) -> Candidate:
    plan, space = problem.start, problem.space
    if not unwrapping_methods()[plan.unwrapping].guided:
        check_unwrapping(plan, source)  # a guided one is checked where the calibration is known
    fringes = list(Candidate.of(plan).fringes)
    if any(f != Sinusoid(**asdict(own)) for f, own in zip(plan.fringes, fringes, strict=True)):
        raise ConfigError(f"{source}: 'start' has fringes of imported images, which no rig projects")
    searched = plan.axes if space.axis else plan.unwrapped_axes
    if (space.sets or space.axis) and len(searched) > 1:
        raise ConfigError(f"{source}: 'space' searches sets or axis, and 'start' has fringes along both axes")
    count = space.sets[1] if space.sets else len(fringes)
    for name in ("steps", "stripes"):
        bounds = len(getattr(space, name))
        if bounds not in (0, count):
            raise ConfigError(
                f"{source}: 'space.{name}' has {bounds} bounds for {count} sets; give each its own, or null"
            )
    for i in range(1, count - len(fringes) + 1):
        fringes.insert(i, _additional_set(problem, i, source))
    convergence_deg = 0.0 if space.convergence_deg is not None else None
    if space.exposure_s and plan.exposures_s:
        raise ConfigError(f"{source}: 'space' searches exposure_s, and 'start' has 'exposures_s'")
    return Candidate(tuple(fringes), plan.exposure_s, plan.stage_mm, convergence_deg, plan.exposures_s)


def _pattern_bits(values: Mapping[str, float], otherwise: int | None) -> int | None:
    """Bits of a set's patterns; as in a plan, None for all that there are."""
    if "pattern_bits" not in values:
        return otherwise
    return None if values["pattern_bits"] == MAX_PATTERN_BITS else int(values["pattern_bits"])


def _additional_set(problem: SearchProblem, i: int, source: str) -> Fringes:
    steps, stripes = ((*getattr(problem.space, name), None)[i] for name in ("steps", "stripes"))
    if steps is None or stripes is None:
        raise ConfigError(
            f"{source}: 'space.sets' allows more sets than 'start' has, so 'steps[{i}]' and 'stripes[{i}]' "
            "need bounds"
        )
    return Fringes(problem.start.fringes[0].axis, math.sqrt(stripes[0] * stripes[1]), sum(steps) // 2)


def _parameters(problem: SearchProblem) -> Iterator[Parameter]:
    space = problem.space
    if space.sets:
        yield Parameter("sets", "steps", *space.sets, is_integer=True)
    for i, steps in enumerate(space.steps):
        if steps:
            yield Parameter(f"steps[{i}]", "steps", *steps, is_integer=True)
    for i, stripes in enumerate(space.stripes):
        if stripes:
            yield Parameter(f"stripes[{i}]", "stripes", *stripes, is_logarithmic=True)
    if space.axis:
        yield Parameter("axis", "stripes", 0, len(space.axis) - 1, is_integer=True)
    if space.exposure_s:
        yield Parameter("exposure_s", "light", *space.exposure_s, is_logarithmic=True)
    if space.pattern_bits:
        yield Parameter("pattern_bits", "light", *space.pattern_bits, is_integer=True)
    if space.stage_mm:
        yield Parameter("stage_mm", "geometry", *space.stage_mm, grid_step=space.stage_every_mm)
    if space.convergence_deg:
        yield Parameter("convergence_deg", "geometry", *space.convergence_deg)


def _start_value(name: str, problem: SearchProblem, template: Candidate, source: str) -> float:
    kind, _, index = name.rstrip("]").partition("[")
    if index:
        return float(getattr(template.fringes[int(index)], kind))
    if kind == "sets":
        return len(problem.start.fringes)
    if kind == "axis":
        axis, choice = template.fringes[0].axis, problem.space.axis
        return choice.index(axis) if axis in choice else -1
    value = getattr(template, kind)
    if value is None:
        raise ConfigError(f"{source}: 'space.{kind}' is searched, and 'start' has no {kind} to begin with")
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
    space.limits.check(space.candidate(start), f"{source}: 'start'")
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
    point = list(space.start)
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
    searched, sets = space.problem.space.steps, space.problem.space.sets
    steps = [(searched[i] if searched else None) or (f.steps,) for i, f in enumerate(space.template.fringes)]
    count = sets[0] if sets else len(steps)
    return sum(bounds[0] for bounds in (steps[:1] + steps[len(steps) - count + 1 :]))
