"""Frames differ in brightness."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from fpplab.core.config import Positive
from fpplab.core.conventions import Floats
from fpplab.diagnosis.brightness import BrightnessLimits, harmonic_waves
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.fringe_shape import FringeShapeLimits, phase_error_finding, phase_unevenness
from fpplab.diagnosis.limits import CountLimit, LimitsSection
from fpplab.diagnosis.pictures import draw_brightness_by_frame
from fpplab.diagnosis.sample import FrameSample


class FlickerLimits(LimitsSection):
    """How much the brightness of frames may scatter."""

    max_scatter: Positive = 0.01
    """Standard deviation of the frames' brightness, as a share. Measured on benches."""
    min_phase_error_rad: Positive = 0.02
    """RMS phase error by flicker in rad that is reported. Chosen."""
    min_gains: CountLimit = 3
    """Gains of frames, beyond those that a phase takes with it, whose scatter is taken for flicker.
    Measured on benches: of sets of three images one lamp in ten was missed."""
    max_faint_contrast: Positive = 0.15
    """Contrast of fringes below which a frame's mean hardly depends on their place. Measured on benches."""


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    sample, limits = evidence.frames, evidence.limits.of(FlickerLimits)
    if not sample.measured.any():
        return
    fit, errors = sample.widest, sample.errors.sets[sample.recording.plan.finest_set()]
    scatter = _scatter_of_gains(sample)
    # Where a scene is even, all its pixels are rounded equally.
    rounding = float(sample.recording.grey) / math.sqrt(12.0) / float(np.median(fit.offset[sample.measured]))
    limit = max(limits.max_scatter, rounding)
    if scatter > limit:
        text = f"frames differ in brightness by {100 * scatter:.1f} % RMS (at most {100 * limit:.2g} %)"
        yield Finding(FLICKER, text, scatter / limit)
        return
    if math.isnan(errors.gain_first):
        return
    offset = float(np.median(fit.offset[sample.measured] / fit.modulation[sample.measured]))
    others = np.nan_to_num(errors.harmonic_rad) ** 2 + errors.of_frames
    power = max(float(errors.variance(offset)) - others, 0.0)
    description = "frames of unequal brightness"
    finding = phase_error_finding(sample, FLICKER, math.sqrt(power), limits.min_phase_error_rad, description)
    if finding is not None:
        yield finding


def _scatter_of_gains(sample: FrameSample) -> float:
    """Standard deviation of the frames' brightness, as a share."""
    # A sinusoid fitted to the N images of a set takes three of their N gains with it; N - 3 are left in the
    # residuals, and two are seen where pixels of all phases are compared. Sets of three are compared
    # together.
    total, freedom = 0.0, 0
    for k, fringe in enumerate(sample.recording.plan.fringes):
        gains = _residual_gains(sample, k) if fringe.images > 3 else None
        if gains is None:
            continue
        total, freedom = total + float(gains @ gains), freedom + fringe.images - 3
        first = sample.errors.sets[k].gain_first
        if not math.isnan(first):
            total, freedom = total + 2.0 * first**2 / fringe.images, freedom + 2
    if freedom >= sample.limits.of(FlickerLimits).min_gains:
        return math.sqrt(total / freedom)
    # Gains ε_n of N frames that are independent: the mean of |Σ ε_n exp(iδ_n)|² is N times their variance.
    variances = [
        errors.gain_first**2 / errors.images
        for errors in sample.errors.sets
        if not math.isnan(errors.gain_first)
    ]
    return math.sqrt(np.mean(variances)) if variances else _scatter_without_fringes(sample)


def _scatter_without_fringes(sample: FrameSample) -> float:
    """The same by the means of frames whose fringes are so weak that these hardly depend on them."""
    plan, used = sample.recording.plan, sample.measured
    finest = plan.finest_set()
    fit = sample.fits[finest]
    if (
        plan.fringes[finest].stripes < sample.limits.of(BrightnessLimits).min_stripes_in_part
        or not used.any()
    ):
        return 0.0
    contrast = np.median(fit.modulation[used] / np.maximum(fit.offset[used], 1.0))
    if contrast > sample.limits.of(FlickerLimits).max_faint_contrast:
        return 0.0
    levels = sample.spread[plan.set_starts[finest] : plan.set_starts[finest + 1], used].mean(axis=1)
    return float(levels.std(ddof=1) / levels.mean())


def _residual_gains(sample: FrameSample, k: int) -> Floats | None:
    """Gain (N,) of each frame of a set that the fit of a sinusoid leaves, besides harmonics of the response.

    None where the pixels' phases are few or unevenly spread, so that harmonics look like gains.
    """
    fit, plan, shape = sample.fits[k], sample.recording.plan, sample.limits.of(FringeShapeLimits)
    used = np.flatnonzero(sample.measured)
    # Noise changes the mean brightness of 10 000 pixels by less than 0.1 %.
    used = used[:: max(1, len(used) // 10_000)]
    offset, modulation, phase = (part.ravel()[used] for part in (fit.offset, fit.modulation, fit.phase))
    if len(phase) < shape.min_pixels or (
        phase_unevenness(phase, np.full(phase.shape, True)) > shape.max_unevenness
    ):
        return None
    frames = sample.spread[plan.set_starts[k] : plan.set_starts[k + 1]]
    images = frames.reshape(len(frames), -1)[:, used]
    turn = np.exp(1j * phase) * np.exp(-1j * plan.fringes[k].phase_shifts())[:, None]
    residuals = images - offset - modulation * turn.real
    waves = [modulation * wave for wave in harmonic_waves(turn)]
    per_offset = offset / (offset @ offset)
    gains, shares = residuals @ per_offset, [wave @ per_offset for wave in waves]
    without_gains = np.stack(
        [(wave - share[:, None] * offset).ravel() for wave, share in zip(waves, shares, strict=True)]
    )
    normal, right = without_gains @ without_gains.T, without_gains @ residuals.ravel()
    strengths = np.linalg.lstsq(normal, right, rcond=1e-6)[0]
    return np.asarray(gains - strengths @ np.asarray(shares))


def _draw(evidence: Evidence, _: Finding) -> Figure:
    return draw_brightness_by_frame(evidence.frames, evidence.limits.of(FlickerLimits).max_scatter)


FLICKER = FaultCause(
    key="flicker",
    meaning="Frames differ in brightness.",
    remedy="set the exposure to whole periods of the lamp and of the mains, and let the lamp warm up",
    measured="scatter of the brightness of frames, from the residuals of sinusoids and harmonics; "
    "phase error it causes",
    limit=f"{100 * FlickerLimits().max_scatter:g} %, and the rounding of grey levels; "
    f"{FlickerLimits().min_phase_error_rad:g} rad, and the noise",
    seen_in="frames",
    detectors=(Detector(DetectionStage.FRAMES, _find),),
    picture=Picture(Needs.FRAMES, _draw),
    side_effects=frozenset({"interreflection", "wrong_resolution", "stale_calibration"}),
)
