"""Decode frames into projector coordinates with mask and uncertainty.

Conventions: `fpplab.core.conventions`.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from fpplab.core import buffers
from fpplab.core.conventions import AXES, Axis, Floats, Map, axis_length, full_scale
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.progress import Progress, no_progress
from fpplab.patterns.motion import Compensation
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.patterns.unwrapping import unwrapping_methods
from fpplab.phase.biased_orders import mark_biased_orders
from fpplab.phase.bounds import (
    DecodingBounds,
    PossibleCoordinates,
    PredictedCoordinate,
    check_bounds,
    interval_of,
    widest_interval_share,
)
from fpplab.phase.code_decoding import decode_codes, processors
from fpplab.phase.coded_axes import (
    WITH_CODES,
    axes_by_codes,
    axes_with_orders,
    decode_coded_axis,
    intervals_of,
    joined_axes,
    may_be_a_period_off,
    sets_of_axis,
)
from fpplab.phase.consistency import contradiction
from fpplab.phase.decoded import Decoded
from fpplab.phase.demodulation import AxisPhases, axis_phases
from fpplab.phase.disagreement import widened_by_disagreement
from fpplab.phase.edges import correct_edges
from fpplab.phase.error_model import ErrorModel, error_model_of
from fpplab.phase.guided_axis import around_prediction, joined
from fpplab.phase.isolated import isolated_pixels
from fpplab.phase.kernels import decode_pixels, erase_doubtful
from fpplab.phase.limits import BIASED_ORDERS
from fpplab.phase.one_frame import decode_single_frame, single_frame
from fpplab.phase.outside import outside_share
from fpplab.phase.precision import coordinate_spread
from fpplab.phase.recipe import recipe_of
from fpplab.phase.spatial_axis import unwrap_by_neighbours
from fpplab.phase.tables import Maps, Recipe
from fpplab.phase.unwrapping import WavelengthSequence, check_unwrapping, wavelength_sequence

_BLOCK = 1 << 18  # pixels that one thread decodes at a time (chosen)


def decode(
    recording: Recording,
    progress: Progress = no_progress,
    bounds: DecodingBounds | None = None,
) -> Decoded:
    """Find projector coordinates, modulation and uncertainty of every camera pixel.

    The frames are read once; besides the result's maps little memory is needed.

    Parameters
    ----------
    recording : Recording
        All frames of a plan.
    progress : callable
        Called with the share done, 0 … 1; what it raises ends the work.
    bounds : mapping of str to PossibleCoordinates or PredictedCoordinate, optional
        By axis, which projector coordinates each camera pixel may have, as calibration and depth range tell;
        by default all of the projector's. Guided unwrapping needs them. A plan's guided axis needs its
        prediction, and is left out without it.

    Returns
    -------
    Decoded
        Maps (height, width) of float32, NaN where a pixel is not measured.

    Raises
    ------
    ConfigError
        The plan does not suit the projector or cannot be unwrapped.
    DataError
        The frames are not the plan's: wrong number, size, type or depth.
    """
    if not isinstance(recording, Recording):
        raise ConfigError(
            f"recording: takes a Recording, such as session.recording(), not a {type(recording).__name__}"
        )
    recording = recording.checked()
    if single_frame(recording.plan):
        return decode_single_frame(recording, bounds or {}, progress)
    if recording.fringe_part is recording:
        return _with_motion(_decode_fringes(recording, progress, bounds or {}), recording.motion)
    return _decode_codes_and_fringes(recording, progress, bounds or {})


def _with_motion(decoded: Decoded, motion: Compensation | None) -> Decoded:
    """State what frames of parts that moved tell less well than those of parts at rest."""
    if motion is None:
        return decoded
    common = decoded.sigma_phase_error
    common = None if common is None else np.hypot(common, motion.left_px)
    return replace(decoded, sigma=decoded.sigma * motion.noise, sigma_phase_error=common)


def _decode_fringes(
    recording: Recording, progress: Progress, bounds: DecodingBounds, coded: tuple[Axis, ...] = ()
) -> Decoded:
    errors = error_model_of(recording)
    return replace(_decode_axes(recording, errors, progress, bounds, coded), drifts=errors.drifts)


def _decode_codes_and_fringes(recording: Recording, progress: Progress, bounds: DecodingBounds) -> Decoded:
    """Decode axes by codes, and by fringes whose orders codes, other fringes or the geometry tell."""
    plan, size = recording.plan, recording.projector_size
    with_orders, part = axes_with_orders(plan, size), recording.fringe_part
    by_codes = axes_by_codes(plan, size)
    by_fringes = tuple(axis for axis in plan.axes if axis not in by_codes)
    within, unclear = dict(bounds), np.zeros(recording.frames[0].shape, np.bool_)
    repeats_px: dict[Axis, float] = {}
    count = len(with_orders) + len(by_codes) + bool(by_fringes)

    def of_part(k: int) -> Progress:
        return lambda share: progress((k + share) / count)

    for k, (axis, periods) in enumerate(with_orders.items()):
        known = bounds.get(axis)
        known = known if isinstance(known, PossibleCoordinates) else None
        codes = decode_codes(recording, axis, sets_of_axis(plan, axis, with_fringes=False), known, of_part(k))
        within[axis], unknown, repeats_px[axis] = intervals_of(codes, periods, axis_length(size, axis), known)
        unclear |= unknown
    parts: dict[Axis, Decoded] = {
        axis: decode_coded_axis(recording, axis, bounds, of_part(k))
        for k, axis in enumerate(by_codes, len(with_orders))
    }
    if part and by_fringes:
        fringes = part if len(by_fringes) == len(part.plan.axes) else part.along(by_fringes[0])
        decoded = _decode_fringes(fringes, of_part(count - 1), within, tuple(with_orders))
        for axis, period_px in repeats_px.items():
            possible = within[axis]
            assert isinstance(possible, PossibleCoordinates)
            steps = part.plan.fringes[part.plan.finest_set(axis)].images
            unclear |= may_be_a_period_off(decoded.coordinate(axis), possible, period_px, steps)
        _drop(decoded, np.flatnonzero(unclear))
        if not by_codes:
            return decoded
        parts[by_fringes[0]] = decoded
    return joined_axes(parts)


def _decode_axes(
    recording: Recording,
    errors: ErrorModel,
    progress: Progress,
    bounds: DecodingBounds,
    coded: tuple[Axis, ...],
) -> Decoded:
    guided = recording.plan.guided_axis
    possible = {a: b for a, b in bounds.items() if isinstance(b, PossibleCoordinates)}
    check_bounds(possible, recording)
    if guided is None:
        return _decode_leading(recording, errors, progress, possible, coded)
    if fault := recording.plan.guidance_fault():
        raise ConfigError(f"{recording.name}: {fault}")
    (leading,) = recording.plan.unwrapped_axes
    first, second = recording.along(leading), recording.along(guided)
    decoded = _decode_leading(first, errors.of_sets(0, -1), progress, possible, coded)
    prediction = bounds.get(guided)
    if not isinstance(prediction, PredictedCoordinate):
        return decoded
    decoded = decoded.of_known_order()
    predicted = prediction.predict(decoded.coordinate(leading))
    interval = {guided: around_prediction(predicted, second)}
    along = _decode_unwrapped(second, errors.of_sets(-1, None), no_progress, interval)
    return joined(decoded, along, predicted, second)


def _decode_leading(
    recording: Recording,
    errors: ErrorModel,
    progress: Progress,
    bounds: Mapping[Axis, PossibleCoordinates],
    coded: tuple[Axis, ...],
) -> Decoded:
    """Decode the axes that nothing guides, by neighbours where the plan says so and no code tells orders."""
    if not unwrapping_methods()[recording.plan.unwrapping].spatial or coded:
        return _decode_unwrapped(recording, errors, progress, bounds or None, coded)
    check_unwrapping(recording.plan, recording.name)
    (axis,) = recording.plan.axes
    islands = unwrap_by_neighbours(recording, axis, errors, bounds.get(axis))
    within = {axis: around_prediction(islands.coordinate, recording)}
    decoded = _decode_unwrapped(recording, errors, progress, within, (axis,))
    _drop(decoded, np.flatnonzero(islands.island == 0))
    return replace(decoded, island=np.where(decoded.valid, islands.island, np.int32(0)))


def _decode_unwrapped(
    recording: Recording,
    errors: ErrorModel,
    progress: Progress,
    bounds: Mapping[Axis, PossibleCoordinates] | None,
    coded: tuple[Axis, ...] = (),
) -> Decoded:
    """Decode all axes, each unwrapped by its own sets, or within what codes of other kinds tell."""
    plan, bits, source, size = recording.plan, recording.bits, recording.name, recording.projector_size
    sequences = [
        wavelength_sequence(
            plan,
            axis,
            source,
            widest_interval_share(bounds, axis, size),
            WITH_CODES if axis in coded else None,
        )
        for axis in plan.axes
    ]
    recipe = recipe_of(recording, sequences, errors, bounds)
    first = recording.frames[0]
    maps = _allocate(first.size, plan)
    highest = _run_kernel(recipe, first.dtype, first.size, maps, progress)
    if highest > full_scale(bits):
        raise DataError(
            f"{source}: holds values up to {highest:g}, above the full scale {full_scale(bits)} of "
            f"{bits} bits; say how many bits the camera gives"
        )
    _drop_doubtful_orders(maps, recording, sequences, errors, bounds)
    by_axis = {axis: maps.u if axis == "x" else maps.v for axis in plan.axes}
    coordinates = {axis: values.reshape(first.shape) for axis, values in by_axis.items()}
    maps.modulation[:] = recording.light(maps.modulation.reshape(first.shape)).ravel()
    parts = (maps.modulation, maps.sigma, maps.phase_error)
    modulation, sigma, phase_error = (part.reshape(first.shape) for part in parts)
    blur_px2 = errors.sets[plan.finest_set(plan.axes[0])].blur_px2
    edges = correct_edges(coordinates, modulation, sigma, phase_error, recording, blur_px2)
    outside = outside_share(recording, sequences, errors, bounds)
    decoded = _decoded_from_maps(recording, maps, first.shape, errors.phase_error_is_known)
    decoded = replace(decoded, outside=outside, edges=edges)
    for sequence in sequences:
        coordinate = decoded.coordinate(sequence.axis)
        period = axis_length(size, sequence.axis) / plan.fringes[sequence.finest].stripes
        _drop(decoded, np.flatnonzero(isolated_pixels(coordinate, period)))
    return widened_by_disagreement(decoded, plan)


def _allocate(pixels: int, plan: Plan) -> Maps:
    """Maps for what the plan measures; empty ones for what it does not."""
    along = {axis: pixels if axis in plan.axes else 0 for axis in AXES}
    sizes = (along["x"], along["y"], pixels, pixels, pixels, pixels)
    u, v, modulation, sigma, phase_error, disagreement = (buffers.empty(n) for n in sizes)
    cause = buffers.empty(pixels, np.uint8)
    cause[:] = 0
    return Maps(u, v, modulation, sigma, phase_error, disagreement, cause)


def _decoded_from_maps(
    recording: Recording, maps: Maps, shape: tuple[int, ...], phase_error_is_known: bool
) -> Decoded:
    plan, size = recording.plan, recording.projector_size
    spreads = [coordinate_spread(plan, axis, size) for axis in plan.axes]
    v_per_u = spreads[1] / spreads[0] if len(spreads) == 2 else 1.0
    u, v, modulation, sigma, disagreement = (
        _shaped(m, shape) for m in (maps.u, maps.v, maps.modulation, maps.sigma, maps.disagreement)
    )
    uncertain = maps.cause.reshape(shape)
    phase_error = _shaped(maps.phase_error, shape) if phase_error_is_known else None
    decoded = Decoded(u, v, modulation, sigma, v_per_u, disagreement, uncertain_order=uncertain)
    return replace(decoded, sigma_phase_error=phase_error)


def _shaped(flat: Map, shape: tuple[int, ...]) -> Map:
    return flat.reshape(shape) if flat.size else np.broadcast_to(np.float32(np.nan), shape)


def _run_kernel(
    recipe: Recipe, dtype: np.dtype[np.generic], pixels: int, maps: Maps, progress: Progress
) -> float:
    """The kernel on all processors, block by block; the greatest raw value met."""
    highest = 0.0
    pool = ThreadPoolExecutor(processors())
    try:
        blocks = [
            pool.submit(decode_pixels, recipe, dtype.itemsize, start, min(start + _BLOCK, pixels), maps)
            for start in range(0, pixels, _BLOCK)
        ]
        for done, block in enumerate(as_completed(blocks), start=1):
            highest = max(highest, float(block.result()))
            progress(done / len(blocks))
    finally:
        # Workers hold bare addresses: this must not return before they have stopped.
        pool.shutdown(wait=True, cancel_futures=True)
    return highest


def _drop_doubtful_orders(
    maps: Maps,
    recording: Recording,
    sequences: Sequence[WavelengthSequence],
    errors: ErrorModel,
    bounds: Mapping[Axis, PossibleCoordinates] | None,
) -> None:
    """Erase pixels whose order a bias may have changed, and all that the kernel keeps of doubtful ones."""
    plan, shape = recording.plan, recording.frames[0].shape
    may_be_biased = plan.masks.wrong_order_max < 1.0
    sigma, cause = maps.sigma.reshape(shape), maps.cause.reshape(shape)
    # The noise of phases is the same along both axes, and `sigma` that of the first one.
    finest = plan.fringes[plan.finest_set(plan.axes[0])].stripes
    max_sigma = BIASED_ORDERS.max_noise_turns * axis_length(recording.projector_size, plan.axes[0]) / finest
    for sequence in sequences:
        if may_be_biased and len(sequence.wavelengths) > 1:
            length = axis_length(recording.projector_size, sequence.axis)
            mark_biased_orders(
                (maps.u if sequence.axis == "x" else maps.v).reshape(shape),
                sigma,
                cause,
                max_sigma=max_sigma,
                mark=1 + sequence.sets[0],
                period=length / sequence.wavelengths[-1].stripes,
                widest=length / sequence.wavelengths[0].stripes,
                contradiction=partial(_contradiction, recording, sequence, errors, bounds),
            )
    if cause.any():
        erase_doubtful(maps)


def _contradiction(
    recording: Recording,
    sequence: WavelengthSequence,
    errors: ErrorModel,
    bounds: Mapping[Axis, PossibleCoordinates] | None,
    pixels: NDArray[np.int64],
) -> Floats:
    """How far the sets of a few pixels contradict each other, with its sign and in turns."""
    measured = _phases_at(recording, sequence, errors, pixels)
    length = axis_length(recording.projector_size, sequence.axis)
    interval = interval_of(bounds, sequence.axis, length, pixels)
    return contradiction(measured, sequence, interval)


def _drop(decoded: Decoded, pixels: NDArray[np.int64]) -> None:
    for values in decoded.maps:
        if values is not None and values.flags.writeable:
            values.reshape(-1)[pixels] = np.nan


def _phases_at(
    recording: Recording, sequence: WavelengthSequence, errors: ErrorModel, pixels: NDArray[np.int64]
) -> AxisPhases:
    """What a few pixels see of the sets of one axis, as maps (P,)."""
    few = [frame.reshape(-1)[pixels] for frame in recording.frames]
    return axis_phases(replace(recording, frames=few), sequence, errors)
