"""Axes that other codes than fringes tell: alone, or as the orders of fringes along the same axis."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from fpplab.core.conventions import Axis, Lattice, Map, Mask, axis_length
from fpplab.core.errors import ConfigError
from fpplab.core.progress import Progress
from fpplab.patterns.fringe_sets import PatternSet
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.patterns.unwrapping import SyntheticWavelength, unwrapping_methods
from fpplab.phase.bounds import DecodingBounds, PossibleCoordinates
from fpplab.phase.code_decoding import CodedAxis, decode_codes
from fpplab.phase.code_table import code_table, code_uncertainty, nearest_codes
from fpplab.phase.decoded import Decoded
from fpplab.phase.error_model import saturation_of
from fpplab.phase.limits import CODES

WITH_CODES = "guided"  # how fringes are unwrapped whose interval codes tell


def sets_of_axis(plan: Plan, axis: Axis, *, with_fringes: bool) -> tuple[int, ...]:
    """Indices of the sets that tell the coordinate along an axis; even light tells white and black."""
    return tuple(
        k
        for k, each in enumerate(plan.sets)
        if each.coded_axis in (axis, None) and (with_fringes or k not in plan.fringe_indices)
    )


def axes_by_codes(plan: Plan, size: tuple[int, int]) -> list[Axis]:
    """List the axes whose sets tell the coordinate all together: codes do not tell the orders of fringes."""
    with_orders = axes_with_orders(plan, size)
    if plan.images == 1:  # whose neighbours tell it, see `fpplab.phase.one_frame`
        return []
    return [axis for axis in plan.axes if axis not in with_orders and _has_codes(plan, axis)]


def axes_with_orders(plan: Plan, size: tuple[int, int]) -> dict[Axis, list[float]]:
    """Give the axes along which codes tell the orders of fringes, with the periods of those in px."""
    # Shortest first, those of their beats too; size (width, height) px
    periods: dict[Axis, list[float]] = {}
    part = plan.fringe_part
    for axis in plan.axes:
        codes = sets_of_axis(plan, axis, with_fringes=False)
        fringes = part.sets_along(axis) if part else ()
        if part is None or not fringes or not _has_codes(plan, axis):
            continue
        units = [
            SyntheticWavelength(tuple(int(i == k) for i in range(len(fringes))), part.fringes[index].stripes)
            for k, index in enumerate(fringes)
        ]
        wavelengths, length = unwrapping_methods()[WITH_CODES].wavelengths(units), axis_length(size, axis)
        own = sorted(length / wavelength.stripes for wavelength in wavelengths)
        kinds = tuple(plan.sets[k] for k in codes)
        if _distance(kinds, axis, size, 0.5 * own[-1])[0] >= min_distance():
            periods[axis] = own
    return periods


def coded_coordinate(
    plan: Plan, axis: Axis, size: tuple[int, int], noise: float, blur_px: float = CODES.usual_blur_px
) -> tuple[float, float]:
    """Uncertainty in px of a coordinate that all sets of an axis tell together, and the chance of another."""
    # noise of a grey level, as a share of the modulation
    kinds = tuple(plan.sets[k] for k in sets_of_axis(plan, axis, with_fringes=True))
    table = code_table(kinds, axis, size, Lattice.SQUARE, blur_px)
    return code_uncertainty(table, noise, CODES.apart_px)


def min_distance() -> float:
    """Distance of two codes at which noise takes one for the other at a pixel in ten thousand."""
    # Noise is stated beside the amplitude, half of the light's range; the midpoint must be 3.7 sigma off.
    return 2.0 * CODES.confusion_sigmas * 0.5 * CODES.noise_share


def check_codes(plan: Plan, size: tuple[int, int], source: str) -> None:
    """Refuse a plan whose codes of other kinds than fringes do not tell coordinates apart."""
    # size (width, height) px
    for axis in axes_by_codes(plan, size):
        _check_axis(plan, axis, size, source)


def _has_codes(plan: Plan, axis: Axis) -> bool:
    """Whether an axis has codes of other kinds than fringes."""
    return any(plan.sets[k].coded_axis for k in sets_of_axis(plan, axis, with_fringes=False))


def _check_axis(plan: Plan, axis: Axis, size: tuple[int, int], source: str) -> None:
    kinds = tuple(plan.sets[k] for k in sets_of_axis(plan, axis, with_fringes=True))
    images = sum(each.images for each in kinds)
    if images < 3:
        raise ConfigError(
            f"{source}: 'fringes' have {images} images that tell the coordinate along {axis}; offset, "
            "modulation and coordinate need at least 3"
        )
    distance, first, second = _distance(kinds, axis, size, CODES.apart_px)
    if distance < min_distance():
        raise ConfigError(
            f"{source}: 'fringes' along {axis} look alike at coordinates {first:.0f} and {second:.0f} px: "
            f"with the usual blur of {CODES.usual_blur_px:g} px their codes differ by {distance:.2f} of the "
            f"range of light; noise of {CODES.noise_share:g} of the modulation needs {min_distance():.2f}; "
            "add a set that tells them apart"
        )


@lru_cache(maxsize=16)  # a plan is asked when it is checked, decoded and judged
def _distance(
    kinds: tuple[PatternSet, ...], axis: Axis, size: tuple[int, int], apart_px: float
) -> tuple[float, float, float]:
    return nearest_codes(code_table(kinds, axis, size, Lattice.SQUARE, CODES.usual_blur_px), apart_px)


def intervals_of(
    coded: CodedAxis, periods: Sequence[float], length: int, known: PossibleCoordinates | None
) -> tuple[PossibleCoordinates, Mask, float]:
    """Give the coordinates that codes leave possible, and where they leave too many."""
    # periods of fringes and their beats in px, the shortest first; returns intervals, of no width where the
    # codes leave too many, where that is, and the period in px with which unwrapping begins
    # Unwrapping begins with the shortest period that holds most intervals: beats are less certain.
    width, unambiguous = coded.upper - coded.lower, coded.gap >= CODES.hull_chi2
    usual = float(np.quantile(width[unambiguous], CODES.usual_width_share)) if unambiguous.any() else 0.0
    fitting = [period for period in periods if period * (1.0 + 1e-3) >= usual]
    widest_px = (fitting or periods[-1:])[0] * (1.0 - 1e-4)  # less by more than rounding
    # A cell as wide as a period leaves no room for a margin.
    spare = 0.5 * (widest_px - width)
    clear: Mask = (spare > -5e-2) & unambiguous
    margin = np.minimum(spare, CODES.margin_share * widest_px)
    lower = np.maximum(coded.lower - margin, -0.5)
    upper = np.minimum(coded.upper + margin, length - 0.5)
    if known is not None:
        lower, upper = np.maximum(lower, known.lower), np.minimum(upper, known.upper)
    clear &= upper > lower
    lower, upper = (np.where(clear, end, np.float32(0.0)).astype(np.float32) for end in (lower, upper))
    return PossibleCoordinates(lower, upper), ~clear, widest_px


def may_be_a_period_off(coordinate: Map, possible: PossibleCoordinates, period_px: float, steps: int) -> Mask:
    """Tell where a phase error may have put a coordinate at the other end of a whole period."""
    # Three steps do not suppress the second harmonic of the response.
    guard_px = (CODES.guard_of_three if steps <= 3 else CODES.guard) * period_px
    spans = possible.upper - possible.lower > period_px - 2.0 * guard_px
    at_end = (coordinate < possible.lower + guard_px) | (coordinate > possible.upper - guard_px)
    return np.asarray(spans & at_end)


def decode_coded_axis(
    recording: Recording, axis: Axis, bounds: DecodingBounds, progress: Progress
) -> Decoded:
    """Decode an axis by all its sets together, where codes do not tell the orders of fringes."""
    plan, rules = recording.plan, recording.plan.masks
    _check_axis(plan, axis, recording.projector_size, recording.name)
    sets, known = sets_of_axis(plan, axis, with_fringes=True), bounds.get(axis)
    known = known if isinstance(known, PossibleCoordinates) else None
    coded = decode_codes(recording, axis, sets, known, progress)
    chance = np.exp(-0.5 * np.nan_to_num(coded.gap))
    variance = np.float32(coded.noise.constant) + np.float32(coded.noise.per_level) * coded.offset
    left = np.sqrt(coded.misfit * variance) / coded.modulation
    usable = (coded.modulation >= rules.modulation_min) & (left <= rules.residual_max)
    usable &= coded.modulation >= rules.contrast_min * coded.offset
    usable &= ~_saturated(recording, sets)
    uncertain = usable & (chance > rules.wrong_order_max)
    usable &= ~uncertain
    light = recording.light(coded.modulation)
    nan = np.float32(np.nan)
    coordinate, modulation, sigma, misfit = (
        np.where(usable, values, nan)
        for values in (coded.coordinate, light, coded.sigma, np.sqrt(coded.misfit))
    )
    empty = np.broadcast_to(nan, coordinate.shape)
    u, v = (coordinate, empty) if axis == "x" else (empty, coordinate)
    cause = uncertain.astype(np.uint8) * np.uint8(1 + sets[0])
    return Decoded(u, v, modulation, sigma, disagreement=misfit, uncertain_order=cause)


def _saturated(recording: Recording, sets: tuple[int, ...]) -> Mask:
    highest = np.zeros_like(recording.frames[0])
    for k in sets:
        for frame in recording.of_set(k):
            np.maximum(highest, frame, out=highest)
    return np.asarray(highest >= saturation_of(recording))


def joined_axes(parts: Mapping[Axis, Decoded]) -> Decoded:
    """Join two axes that were decoded by themselves; a pixel needs both."""
    if len(parts) == 1:
        return next(iter(parts.values()))
    along_x, along_y = parts["x"], parts["y"]
    both = along_x.valid & along_y.valid
    for part in parts.values():
        for values in part.maps:
            if values is not None and values.flags.writeable:
                values[~both] = np.nan
    ratio = along_y.sigma[both] / along_x.sigma[both]
    causes = [part.uncertain_order for part in (along_x, along_y) if part.uncertain_order is not None]
    worse = [part.disagreement for part in (along_x, along_y) if part.disagreement is not None]
    return replace(
        along_x,
        v=along_y.v,
        v_per_u=float(np.median(ratio)) if ratio.size else 1.0,
        uncertain_order=np.maximum.reduce(causes) if causes else None,
        disagreement=np.fmax.reduce(worse) if worse else None,
    )
