"""What the projector shows during the set-up: a short cycle of fringes for measuring, and still images."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Lattice, axis_length
from fpplab.core.errors import CapabilityError
from fpplab.devices import Projector, ProjectorCaps
from fpplab.patterns.fringe_sets import stepped_fringes
from fpplab.patterns.fringes import Pattern, make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan

SQUARES = 24  # squares of the checkerboard across the projector (chosen)


class View(StrEnum):
    """What the projector shows."""

    MEASURE = "measure"  # the widest and the finest fringes of the plan, step by step: everything is measured
    WHITE = "white"  # white
    BLACK = "black"  # black: light of the room, and the camera's black level
    COARSE = "coarse"  # the first image of the widest fringes
    FINE = "fine"  # the first image of the finest fringes
    CHECKER = "checker"  # a checkerboard, to focus the projector by eye
    CROSS = "cross"  # the border and the middle of the projector's field

    @property
    def even(self) -> bool:
        """Whether the scene can be seen under even light."""
        return self in (View.MEASURE, View.WHITE)


@dataclass(frozen=True, eq=False)
class LivePatterns:
    """The patterns that a projector holds during the set-up."""

    plan: Plan  # of the cycle: two sets along the first axis, the widest first
    patterns: tuple[Pattern, ...]  # all of them; those of the cycle first
    views: dict[View, tuple[int, ...]]  # which of them each view shows, in turn


def live_patterns(plan: Plan, caps: ProjectorCaps) -> Iterator[LivePatterns]:
    plan = plan.fringe_part or as_fine_fringes(plan, caps.size)
    yield _with_stills(_short_plan(plan), caps)
    yield _of_cycle(_widest_and_finest_sets(plan), caps)


def loaded_patterns(plan: Plan, projector: Projector) -> LivePatterns:
    choices = list(live_patterns(plan, projector.caps))
    for choice in choices[:-1]:
        try:
            projector.load(choice.patterns)
        except CapabilityError:
            continue
        return choice
    projector.load(choices[-1].patterns)
    return choices[-1]


def as_fine_fringes(plan: Plan, size: tuple[int, int]) -> Plan:
    """Sinusoids along the first axis of codes, as fine as these."""
    axis = plan.axes[0]
    length = axis_length(size, axis)
    finest = max(each.finest_stripes(length) for each in plan.sets if each.coded_axis == axis)
    pair = tuple(stepped_fringes(axis, stripes, 4) for stripes in (1.0, finest))
    return plan.model_copy(update={"fringes": pair})


def _widest_and_finest_sets(plan: Plan) -> Plan:
    sets = plan.sets_along(plan.axes[0])
    chosen = tuple(plan.fringes[k] for k in dict.fromkeys((sets[0], sets[-1])))
    return plan.model_copy(update={"fringes": chosen})


def _short_plan(plan: Plan) -> Plan:
    """The same with few steps, and with wide stripes where the plan has none."""
    finest = plan.finest
    widest = plan.fringes[plan.sets_along(plan.axes[0])[0]]
    stripes = widest.stripes
    if finest.stripes < 4.0 * stripes:  # too close to compare their contrasts
        stripes = max(finest.stripes / 16.0, 1.0)
    # Four steps are the fewest that also show the noise.
    pair = (
        stepped_fringes(finest.axis, count, 4, projector_size=finest.projector_size)
        for count in (stripes, finest.stripes)
    )
    return plan.model_copy(update={"fringes": tuple(pair)})


def _of_cycle(plan: Plan, caps: ProjectorCaps) -> LivePatterns:
    patterns = make_patterns(plan, caps.size, caps.lattice)
    views = {View.MEASURE: tuple(range(len(patterns))), View.COARSE: (0,), View.FINE: (plan.set_starts[-2],)}
    return LivePatterns(plan, patterns, views)


def _with_stills(plan: Plan, caps: ProjectorCaps) -> LivePatterns:
    cycle, (black, white) = _of_cycle(plan, caps), uniform_patterns([0, 255], caps.size)
    stills = {
        View.WHITE: white,
        View.BLACK: black,
        View.CHECKER: Pattern("live-checker", _checker_image(caps.size, caps.lattice)),
        View.CROSS: Pattern("live-cross", _cross_image(caps.size, caps.lattice)),
    }
    first = len(cycle.patterns)
    views = cycle.views | {view: (first + k,) for k, view in enumerate(stills)}
    return LivePatterns(plan, (*cycle.patterns, *stills.values()), views)


def _square_sides(size: tuple[int, int], mirror_lattice: Lattice, across: int) -> tuple[int, int]:
    """Width and height in mirrors of a square of which this number lies across the projector."""
    side = max(1, size[0] // across)
    return side, side * (2 if mirror_lattice is Lattice.DIAMOND else 1)


def _checker_image(size: tuple[int, int], mirror_lattice: Lattice) -> NDArray[np.uint8]:
    side, rise = _square_sides(size, mirror_lattice, SQUARES)
    columns, rows = np.arange(size[0]) // side, np.arange(size[1]) // rise
    return np.asarray(255 * ((rows[:, None] + columns) % 2), np.uint8)


def _cross_image(size: tuple[int, int], mirror_lattice: Lattice) -> NDArray[np.uint8]:
    (width, height), (side, rise) = size, _square_sides(size, mirror_lattice, 10 * SQUARES)
    image = np.zeros((height, width), np.uint8)
    image[:rise], image[-rise:], image[:, :side], image[:, -side:] = 255, 255, 255, 255
    image[(height - rise) // 2 : (height + rise) // 2 + 1] = 255
    image[:, (width - side) // 2 : (width + side) // 2 + 1] = 255
    return image
