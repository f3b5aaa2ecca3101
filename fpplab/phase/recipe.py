"""A recording as the compiled decoder's tables."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import AXES, TWO_PI, Axis, Floats, axis_length
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.recording import Recording
from fpplab.phase.alternatives import alternatives_of
from fpplab.phase.bounds import PossibleCoordinates
from fpplab.phase.error_model import ErrorModel, misfit_limits
from fpplab.phase.kernels import GROUP
from fpplab.phase.limits import ORDERS
from fpplab.phase.tables import Recipe
from fpplab.phase.unwrapping import WavelengthSequence


def recipe_of(
    recording: Recording,
    sequences: Sequence[WavelengthSequence],
    errors: ErrorModel,
    bounds: Mapping[Axis, PossibleCoordinates] | None = None,
) -> Recipe:
    """Give frames, plan, rules and noise as tables."""
    addresses, weights, shift, first = _frame_tables(recording)
    plan, size = recording.plan, recording.projector_size
    wavelengths = [wavelength for sequence in sequences for wavelength in sequence.wavelengths]
    of_axis: dict[Axis, WavelengthSequence] = {sequence.axis: sequence for sequence in sequences}
    counts = [len(of_axis[axis].wavelengths) if axis in of_axis else 0 for axis in AXES]
    finest = [of_axis[axis].finest if axis in of_axis else -1 for axis in AXES]
    f32, rules, images = np.float32, plan.masks, np.array([f.images for f in plan.fringes], np.float64)
    # Errors of the phase count in units of its noise, and do not grow with that.
    per_noise = 0.5 * images / [error.scatter for error in errors.sets]
    risks = [alternatives_of(plan, sequence) for sequence in sequences]
    of_risk = {sequence.axis: risk for sequence, risk in zip(sequences, risks, strict=True)}
    by_axis = [of_risk.get(axis) for axis in AXES]
    low_u, high_u, low_v, high_v = (
        end for axis in AXES for end in _interval_of(bounds, axis, axis_length(size, axis))
    )
    return Recipe(
        addresses=addresses,
        weights=weights,
        first=first,
        origin=np.array([f.demodulation().origin_rad / TWO_PI % 1.0 for f in plan.fringes], f32),
        coefficients=_coefficients(sequences, len(plan.fringes)),
        stripes=np.array([wavelength.stripes for wavelength in wavelengths], f32),
        trust=np.array([trust for sequence in sequences for trust in sequence.trust], f32),
        wavelengths=np.cumsum([0, *counts]),
        finest=np.array(finest),
        length=np.array(size, f32),
        axis=np.array([AXES.index(f.axis) for f in plan.fringes]),
        set_stripes=np.array([f.stripes for f in plan.fringes], f32),
        phase_noise=np.array(_phase_noise(plan.fringes, errors), f32),
        low_u=low_u,
        high_u=high_u,
        low_v=low_v,
        high_v=high_v,
        alternatives=np.cumsum([0, *(len(risk.shifts) if risk else 0 for risk in by_axis)]),
        shifts=np.concatenate([risk.shifts for risk in risks]).astype(f32),
        shift_turns=_over_all_sets(sequences, [risk.turns for risk in risks], len(plan.fringes)),
        causes=np.concatenate([risk.causes for risk in risks]),
        least_separation=np.array([risk.least_separation if risk else np.inf for risk in by_axis]),
        edge_shift=np.array([risk.edge if risk else np.inf for risk in by_axis]),
        counted_share=np.array([errors.counted_share(of_axis[a]) if a in of_axis else 1.0 for a in AXES]),
        order_margin=ORDERS.edge_margin_px / np.array(size, np.float64),
        wrong_order_max=rules.wrong_order_max,
        reference=sequences[0].finest,
        grey=f32(recording.grey),
        full_scale=f32(errors.saturation),
        modulation_min=f32(rules.modulation_min),
        contrast_min=f32(rules.contrast_min),
        misfit_max=np.array([rules.residual_max**2 + error.misfit for error in errors.sets], f32),
        disagreement_max=f32(rules.disagreement_max),
        edge_margin=f32(ORDERS.edge_margin_px),
        noise_constant=f32(errors.noise.constant),
        noise_per_level=f32(errors.noise.per_level),
        step=f32(errors.noise.step),
        rounding_repeats=errors.noise.rounding_repeats,
        misfit=np.array([misfit_limits(error) for error in errors.sets], f32),
        images=images.astype(f32),
        error_constant=(per_noise * [error.terms[0] for error in errors.sets]).astype(f32),
        error_harmonic=(per_noise * [error.harmonic_rad**2 for error in errors.sets]).astype(f32),
        error_rising=(per_noise * [error.terms[1] for error in errors.sets]).astype(f32),
        harmonics=np.array([error.harmonics for error in errors.sets], f32),
        shift=shift,
    )


def _phase_noise(fringes: Sequence[FringeSet], errors: ErrorModel) -> list[float]:
    """Variance of each set's phase in turns squared, per unit of (u_I/B)²."""
    return [
        own.scatter * (fringe.phase_noise / TWO_PI) ** 2
        for fringe, own in zip(fringes, errors.sets, strict=True)
    ]


def _interval_of(
    bounds: Mapping[Axis, PossibleCoordinates] | None, axis: Axis, length: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Ends of the intervals as flat arrays of positions, empty where none are known."""
    if bounds is None or axis not in bounds:
        return np.empty(0, np.float32), np.empty(0, np.float32)
    low, high = bounds[axis].positions(length)
    return low.ravel(), high.ravel()


def _over_all_sets(
    sequences: Sequence[WavelengthSequence], turns: Sequence[Floats], sets: int
) -> NDArray[np.float32]:
    """Phase changes of every shift, over all sets of the plan, (J, S)."""
    table = np.zeros((sum(len(t) for t in turns), sets), np.float32)
    first = 0
    for sequence, of_axis in zip(sequences, turns, strict=True):
        table[first : first + len(of_axis), list(sequence.sets)] = of_axis
        first += len(of_axis)
    return table


def _coefficients(sequences: Sequence[WavelengthSequence], sets: int) -> NDArray[np.float32]:
    """Of every wavelength, over all sets of the plan, (R, S)."""
    rows = []
    for sequence in sequences:
        for wavelength in sequence.wavelengths:
            row = np.zeros(sets, np.float32)
            row[list(sequence.sets)] = wavelength.coefficients
            rows.append(row)
    return np.array(rows)


def _frame_tables(
    recording: Recording,
) -> tuple[NDArray[np.uintp], NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
    """Addresses, weights and phase shifts of the frames, each set's padded with frames of weight zero."""
    addresses, weights, shifts, first = [], [], [], [0]
    for index, fringe in enumerate(recording.plan.fringes):
        own = [image.ctypes.data for image in recording.of_set(index)]
        demodulation = fringe.demodulation()
        scale = recording.grey * demodulation.scale
        table = np.stack(
            [scale * demodulation.sine, scale * demodulation.cosine, recording.grey * demodulation.mean],
            axis=1,
        )
        padding = -fringe.images % GROUP
        addresses += own + own[:1] * padding
        weights.append(np.pad(table, ((0, padding), (0, 0))))
        shift = fringe.phase_shifts()
        shifts.append(np.pad(np.stack([np.cos(shift), np.sin(shift)], axis=1), ((0, padding), (0, 0))))
        first.append(len(addresses))
    weight, shift = (np.concatenate(part).astype(np.float32) for part in (weights, shifts))
    return np.array(addresses, np.uintp), weight, shift, np.array(first)
