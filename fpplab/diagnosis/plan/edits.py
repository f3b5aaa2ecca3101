"""Mistakes that people make in plans, each as the edit that corrects it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from fpplab.core.conventions import AXES, TWO_PI, Axis, Floats
from fpplab.diagnosis.plan.sample import Direction, PhaseSample, gradient_directions, wrapped
from fpplab.patterns.fringe_sets import SteppedFringes, indices_along
from fpplab.patterns.plan import Plan

Sets = tuple[SteppedFringes, ...]
LOOK_AT_IMAGES = (
    "see whether the images show the scene mirrored or turned, and then save them as the camera gives them; "
    "otherwise the steps of these sets run the other way"
)
"""What to do where phases run the other way, which images that are turned or mirrored do as well."""


@dataclass(frozen=True)
class Edit:
    """A plan next to the one given."""

    mistake: str  # what would be wrong with the given plan, as a clause
    remedy: str  # what to write in it
    sets: Sets  # the fringe sets of the plan that is right then
    images: tuple[int, ...] = ()  # the order in which the images are right; none where they are already

    def plan(self, stated: Plan) -> Plan:
        return stated.model_copy(update={"fringes": self.sets})


def neighbouring_edits(sets: Sets, sample: PhaseSample) -> Iterator[Edit]:
    """Go through the plans next to one, the simplest first."""
    yield from other_steps(sets)
    finest = finest_of(sets)
    observed = gradient_directions(sample, finest)
    for edit in (
        _other_axes(sets, observed, finest),
        _other_order(sets, observed),
        _other_signs(sets, observed),
    ):
        if edit is not None:
            yield edit
            yield from _with_origins_too(edit, sample)
    yield from _other_stripes(sets, observed, sample)
    if (moved := _other_origins(sets, sample)) is not None:
        yield moved


def image_orders(sets: Sets) -> Iterator[Edit]:
    """All images in reverse, or two of a set exchanged."""
    count = sum(s.images for s in sets)
    mistake = "the images are in reverse order, from the last of the plan to its first"
    yield Edit(mistake, "import them from the last to the first", sets, tuple(range(count))[::-1])
    first = 0
    for each in sets:
        # Of three, an exchange turns the phase, as other edits do; of more than five, the levels show it: see
        # `fpplab.acquisition.synchronisation`.
        for pair in combinations(range(first, first + each.images), 2) if each.images in (4, 5) else ():
            order = list(range(count))
            order[pair[0]], order[pair[1]] = pair[::-1]
            mistake = f"images {pair[0]} and {pair[1]} are exchanged, counted from 0"
            yield Edit(mistake, "give each the other's place", sets, tuple(order))
        first += each.images


def finest_of(sets: Sets) -> int:
    return max(range(len(sets)), key=lambda k: sets[k].stripes)


def other_steps(sets: Sets) -> Iterator[Edit]:
    """All sets with their images in reverse, or one image late or early."""
    yield Edit(
        "the images of each set were taken in reverse order",
        "reverse the images of each set, or write 'shift_sign' with the other sign and 'phase_origin_rad' "
        "one step further in every set",
        tuple(_turned(_moved(s, s.shift_sign * TWO_PI / s.steps)) for s in sets),
    )
    for late, word in ((1, "late"), (-1, "early")):
        yield Edit(
            f"the images of each set are one step {word}, or in reverse order",
            f"begin each set one image {'later' if late > 0 else 'earlier'}, or write 'phase_origin_rad' one "
            "step further in every set",
            tuple(_moved(s, late * s.shift_sign * TWO_PI / s.steps) for s in sets),
        )


def _other_axes(sets: Sets, observed: list[Direction], finest: int) -> Edit | None:
    """Sets whose fringes run along the other axis than the plan says, relative to the finest."""
    own = sets[finest].axis
    axes: list[Axis] = [own if each.parallel else _other(own) for each in observed]
    wrong = [k for k, axis in enumerate(axes) if axis != sets[k].axis]
    if not wrong:
        return None
    return Edit(
        f"the fringes of {_name_sets(sets, wrong)} run along the other axis than those of "
        f"{_name_sets(sets, [finest])}",
        _text_to_write_in_sets(sets, wrong, "axis", lambda k: axes[k]),
        tuple(s.model_copy(update={"axis": axis}) for s, axis in zip(sets, axes, strict=True)),
    )


def _other_order(sets: Sets, observed: list[Direction]) -> Edit | None:
    """Along each axis the same stripes, in the order in which the images have them."""
    stripes = [s.stripes for s in sets]
    for axis in AXES:
        along = indices_along(sets, axis)
        for k, other in zip(sorted(along, key=lambda k: observed[k].speed), along, strict=True):
            stripes[k] = sets[other].stripes
    if stripes == [s.stripes for s in sets]:
        return None
    return Edit(
        "the sets are in another order",
        "in the order of the images they have " + ", ".join(f"{s:g}" for s in stripes) + " stripes",
        tuple(s.model_copy(update={"stripes": n}) for s, n in zip(sets, stripes, strict=True)),
    )


def _other_signs(sets: Sets, observed: list[Direction]) -> Edit | None:
    """Sets whose phase runs against that of the finest set of their axis."""
    wrong = []
    for axis in AXES:
        along = indices_along(sets, axis)
        if along:
            level = sum(abs(observed[k].right) - abs(observed[k].down) for k in along) >= 0
            ways = {k: sets[k].shift_sign * observed[k].way(level) for k in along}
            majority = np.sign(sum(ways.values())) or ways[along[-1]]
            wrong += [k for k in sorted(along) if ways[k] != majority]
    if not wrong:
        return None
    return Edit(
        f"the phase of {_name_sets(sets, wrong)} runs against that of the others",
        _text_to_write_in_sets(sets, wrong, "shift_sign", lambda k: -sets[k].shift_sign),
        tuple(_turned(s) if k in wrong else s for k, s in enumerate(sets)),
    )


def _other_stripes(sets: Sets, observed: list[Direction], sample: PhaseSample) -> Iterator[Edit]:
    """Other numbers of stripes in one set, by the others of its axis, or in all that one set contradicts."""
    for k, fringe in enumerate(sets):
        others = [j for j in indices_along(sets, fringe.axis) if j != k]
        if not others:
            continue
        about = observed[k].speed / float(np.median([observed[j].speed / sets[j].stripes for j in others]))
        is_stated = abs(about / fringe.stripes - 1.0) <= sample.limits.max_equal_stripes
        if is_stated or about > sample.limits.max_stripes:
            continue
        for stripes in _candidate_stripes(sets, others, k, about, sample):
            yield _with_stripes(sets, {k: stripes})
    for reference in range(len(sets)):
        contradicted = _stripes_by_one_set(sets, reference, observed, sample)
        if len(contradicted) > 1:
            yield _with_stripes(sets, contradicted)


def _stripes_by_one_set(
    sets: Sets, reference: int, observed: list[Direction], sample: PhaseSample
) -> dict[int, float]:
    """Stripes that other sets of an axis have if those of one are right, where they are not those stated."""
    along = sorted(indices_along(sets, sets[reference].axis), key=lambda k: observed[k].speed)
    edited, stripes = list(sets), {}
    for rank, k in enumerate(along):
        about = observed[k].speed / observed[reference].speed * sets[reference].stripes
        if abs(about / sets[k].stripes - 1.0) <= sample.limits.max_scale_difference:
            continue
        if about > sample.limits.max_stripes:
            return {}
        coarser = along[:rank]
        has_position = coarser and min(edited[j].stripes for j in coarser) <= 1.0
        number = refined_stripes(edited, coarser, k, about, sample) if has_position else float(round(about))
        if number < 1.0:
            return {}
        stripes[k] = number
        edited[k] = sets[k].model_copy(update={"stripes": number})
    return stripes


def scales_agree(sets: Sets, sample: PhaseSample) -> bool:
    """Whether the phases of an axis' sets change along the image as fast as their stripes say."""
    observed = gradient_directions(sample, finest_of(sets))
    for axis in AXES:
        along = [k for k in indices_along(sets, axis) if sample.has_speed(k, sets[k].images)]
        scales = [observed[k].speed / sets[k].stripes for k in along]
        if scales and max(scales) > (1.0 + sample.limits.max_scale_difference) * min(scales):
            return False
    return True


def _with_stripes(sets: Sets, stripes: Mapping[int, float]) -> Edit:
    return Edit(
        "; ".join(f"{_name_sets(sets, [k])} shows {number:g} stripes" for k, number in stripes.items()),
        _text_to_write_in_sets(sets, list(stripes), "stripes", lambda k: f"{stripes[k]:g}"),
        tuple(s.model_copy(update={"stripes": stripes.get(k, s.stripes)}) for k, s in enumerate(sets)),
    )


def _candidate_stripes(
    sets: Sets, others: Sequence[int], k: int, approximate_stripes: float, sample: PhaseSample
) -> Sequence[float]:
    """Numbers of stripes near an approximate one that set k may have, other than the one stated in it."""
    if min(sets[j].stripes for j in others) <= 1.0 < approximate_stripes:
        near = [refined_stripes(sets, others, k, approximate_stripes, sample)]
    else:
        near = [float(round(approximate_stripes) + by) for by in (0, -1, 1, -2, 2)]
    return [stripes for stripes in near if stripes > 0 and stripes != sets[k].stripes]


def refined_stripes(
    sets: Sequence[SteppedFringes],
    along: Sequence[int],
    k: int,
    approximate_stripes: float,
    sample: PhaseSample,
) -> float:
    others = [j for j in along if j != k and sets[j].stripes < approximate_stripes]
    position = unwrap_finest(sets, others, sample) / sets[max(others, key=lambda j: sets[j].stripes)].stripes
    phase = phases_of(sets, sample)[k]

    def agreement(stripes: float) -> complex:
        return complex(np.mean(np.exp(1j * (phase - stripes * position))))

    reach = max(sample.limits.stripes_searched * approximate_stripes, 1.0)
    whole = np.arange(max(round(approximate_stripes - reach), 1), round(approximate_stripes + reach) + 1)
    usual = max(whole, key=lambda stripes: agreement(stripes).real)  # a whole number, and no origin
    tried = np.linspace(approximate_stripes - reach, approximate_stripes + reach, 401)
    # From one to the next each pixel turns by the same angle.
    turns = np.exp(1j * (phase - tried[0] * position))
    by_step = np.exp(-1j * (tried[1] - tried[0]) * position)
    agreements = []
    for _ in tried:
        agreements.append(abs(complex(np.mean(turns))))
        turns *= by_step
    best = tried[np.argmax(agreements)]
    if agreement(usual).real >= sample.limits.min_whole_agreement * abs(agreement(best)):
        return float(usual)
    return _nearly_whole(float(best))


def _nearly_whole(stripes: float) -> float:
    return (
        float(round(stripes)) if abs(stripes - round(stripes)) < 0.2 and stripes > 0.5 else round(stripes, 2)
    )


def _other_origins(sets: Sets, sample: PhaseSample) -> Edit | None:
    """Phase origins with which finer sets continue coarser ones."""
    moved = with_origins(sets, sample)
    wrong = [k for k, s in enumerate(sets) if moved[k] != s]
    if not wrong:
        return None
    return Edit(
        f"the phase of {_name_sets(sets, wrong)} does not begin where that of the coarser sets does",
        _text_to_write_in_sets(sets, wrong, "phase_origin_rad", lambda k: f"{moved[k].phase_origin_rad:.3f}"),
        moved,
    )


def _with_origins_too(edit: Edit, sample: PhaseSample) -> Iterator[Edit]:
    """The same with phase origins that fit then: images in reverse order within one set, for instance."""
    moved = _other_origins(edit.sets, sample)
    if moved is not None:
        yield Edit(f"{edit.mistake}; {moved.mistake}", f"{edit.remedy}; {moved.remedy}", moved.sets)


def with_origins(sets: Sets, sample: PhaseSample) -> Sets:
    edited = list(sets)
    for axis in AXES:
        along = indices_along(sets, axis)
        for last, (coarse, fine) in enumerate(pairwise(along), 1):
            predicted = (
                unwrap_finest(edited, along[:last], sample) * sets[fine].stripes / sets[coarse].stripes
            )
            residual = phases_of(edited, sample)[fine] - predicted
            origin = float(np.angle(np.mean(np.exp(1j * residual))))
            if abs(origin) > sample.limits.min_origin_rad:
                edited[fine] = _moved(edited[fine], origin)
    return tuple(edited)


def phases_of(sets: Sequence[SteppedFringes], sample: PhaseSample) -> Floats:
    """Give the phases that a plan's sets have in the images."""
    # returns (S, P)
    return np.stack(
        [s.shift_sign * phase - s.phase_origin_rad for s, phase in zip(sets, sample.phases, strict=True)]
    )


def unwrap_finest(sets: Sequence[SteppedFringes], along: Sequence[int], sample: PhaseSample) -> Floats:
    # returns (P,) rad
    ranked = sorted(along, key=lambda k: sets[k].stripes)
    phases = phases_of(sets, sample)
    phase = phases[ranked[0]] % TWO_PI
    for coarse, fine in pairwise(ranked):
        predicted = phase * sets[fine].stripes / sets[coarse].stripes
        phase = predicted + wrapped(phases[fine] - predicted)
    return np.asarray(phase)


def upright_edit(sets: Sets, observed: list[Direction]) -> Edit | None:
    """Give axes and signs by which columns run to the right in the image and rows down."""
    axes: list[Axis] = ["x" if each.level else "y" for each in observed]
    other_axes = [k for k, axis in enumerate(axes) if axis != sets[k].axis]
    other_signs = [k for k, each in enumerate(observed) if each.way(each.level) != sets[k].shift_sign]
    if not other_axes and not other_signs:
        return None
    mistakes, remedies = [], []
    if other_axes:
        mistakes.append(
            f"the fringes of {_name_sets(sets, other_axes)} run along the other axis of the image"
        )
        remedies.append(_text_to_write_in_sets(sets, other_axes, "axis", lambda k: axes[k]))
    if other_signs:
        mistakes.append(f"the phase of {_name_sets(sets, other_signs)} rises to the left or upwards")
        remedies.append(LOOK_AT_IMAGES)
    edited = tuple(
        s.model_copy(update={"axis": axes[k], "shift_sign": observed[k].way(observed[k].level)})
        for k, s in enumerate(sets)
    )
    return Edit(", and ".join(mistakes), "; ".join(remedies), edited)


def is_mirrored(sets: Sets, sample: PhaseSample) -> bool:
    """Tell whether the plan has the scene mirrored, which no camera next to a projector sees."""
    # Both look at the same side of a surface, so columns and rows of the projector turn in the same sense in
    # the image.
    along = [indices_along(sets, axis) for axis in AXES]
    if not all(along):
        return False
    x, y = (sets[ranked[-1]].shift_sign * sample.gradients[ranked[-1]] for ranked in along)
    return bool(np.median(x[:, 0] * y[:, 1] - x[:, 1] * y[:, 0]) < 0)


def _moved(fringe: SteppedFringes, by: float) -> SteppedFringes:
    origin = float(wrapped(np.asarray(fringe.phase_origin_rad + by)))
    return fringe.model_copy(update={"phase_origin_rad": origin})


def _turned(fringe: SteppedFringes) -> SteppedFringes:
    return fringe.model_copy(update={"shift_sign": -fringe.shift_sign})


def _other(axis: Axis) -> Axis:
    return "y" if axis == "x" else "x"


def _name_sets(sets: Sets, set_indices: Sequence[int]) -> str:
    """Name sets by index and stripes, or all along an axis at once."""
    names = []
    for axis in AXES:
        indices = [k for k in set_indices if sets[k].axis == axis]
        if len(indices) == len(indices_along(sets, axis)) > 1:
            names.append(f"every set along {axis}")
        else:
            names += [f"'fringes[{k}]' ({axis}, {sets[k].stripes:g} stripes)" for k in indices]
    return " and ".join(names)


def _text_to_write_in_sets(
    sets: Sets, set_indices: Sequence[int], key: str, value: Callable[[int], object]
) -> str:
    by_value: dict[str, list[int]] = {}
    for k in set_indices:
        by_value.setdefault(str(value(k)), []).append(k)
    return "; ".join(f"write '{key}: {text}' in {_name_sets(sets, ks)}" for text, ks in by_value.items())
