"""Causes that are seen in the frames: light, focus, response, motion."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.diagnosis.brightness import (
    MANY_STRIPES,
    band_finding,
    harmonic_waves,
    light_elsewhere,
    missing_colour,
)
from fpplab.diagnosis.catalogue import FaultCause, Finding
from fpplab.diagnosis.fringe_shape import LEAST_RIPPLED, MOST_UNEVEN, moire, ripples, stray_light, unevenness
from fpplab.diagnosis.sample import FrameSample
from fpplab.phase.quality import phase_uncertainty

DARK_SIGMAS = 15.0
"""Fringes weaker than so many times their noise are none."""

LEAST_COHERENCE = 0.15
"""Share of the modulation's power that neighbours have in common below which it is noise."""

WEAK_SIGMAS = 25.0
"""Fringes that are stronger beside their noise can be told from the dark."""

LEAST_LEVELS = 0.5
"""Modulation in 8-bit grey levels below which there are no fringes, whatever the noise."""

FEWEST_LIT = 4
"""Pixels of the sample that see fringes, where nearly none does."""

LEAST_LIT = 0.03
"""Least share of the image that the fringes should light: a part of a sixth of its width and height."""

MOST_SATURATED = 0.05
"""Greatest share of the lit pixels that may be saturated: highlights."""

LEAST_PEAK = 0.07
"""Least share of full scale that the brightest lit pixels should reach."""

BEST_PEAK = 0.9
"""Share of full scale that the brightest lit pixels reach at the best exposure."""

MOST_AMBIENT = 1.0
"""Greatest share of other light, of the fringes' modulation: noise of photons grows by the root of both."""

LEAST_AMBIENT = 8.0
"""Grey levels of 255 below which what does not change may be the camera's own black level."""

LEAST_HARMONIC_RAD = 0.03
"""Phase error by the response that is worth telling, in rad RMS."""

MUCH_BENT = 2.0
"""Phase error by harmonics that a power law cannot explain, beside that which it does."""

MOST_HARMONICS = 0.15
"""Harmonics as a share of the fringes beyond which pixels are masked as no sinusoids, or soon will be."""

MOST_FLICKER = 0.01
"""Scatter of the frames' brightness that is told."""

LEAST_FREEDOM = 3
"""Fewest gains of frames, beyond those that a phase takes with it, whose scatter is taken for flicker."""

LEAST_FLICKER_RAD = 0.02
"""Phase error by flicker that is worth telling, in rad RMS."""

FAINT = 0.15
"""Contrast of fringes below which the mean of a frame hardly depends on where they lie."""

GAIN_PIXELS = 10_000
"""About so many pixels tell the brightness of a frame: their noise changes it by less than 0.1 %."""

MOST_SHIFT_PX = 0.08
"""Motion between fringe sets that is told, in camera px."""

SHIFT_SIGMAS = 8.0
"""And so many times its standard uncertainty."""


BRIGHTEST_PERCENT = 90.0
"""Percentile of the lit pixels' mean level from which on they tell how far an exposure must be lowered."""

LEAST_DIMMING, MOST_DIMMING = 0.1, 0.9
"""Factors of an exposure that saturates, at least and at most."""


def light_findings(sample: FrameSample) -> Iterator[Finding]:
    """Look for what is wrong with the frames."""
    darkness = list(_darkness(sample))
    if darkness:
        yield from darkness
        return
    colour = missing_colour(sample)
    if colour is not None:
        yield colour
        return  # the other figures take equal frames for granted
    bent_rad = float(sample.errors.sets[sample.recording.plan.finest_set()].harmonic_rad)
    found = [
        one(sample)
        for one in (_saturation, _exposure, _ambient, _response, _motion, band_finding, _flicker, moire)
    ]
    yield from (one for one in (*found, stray_light(sample, bent_rad)) if one is not None)


def _darkness(sample: FrameSample) -> Iterator[Finding]:
    """No fringes at all, or hardly anywhere."""
    noise = float(np.median(sample.noise(sample.widest.offset)))
    strength, share = sample.strongest / noise, float(sample.lit.mean())
    incoherent = strength < DARK_SIGMAS and sample.coherence < LEAST_COHERENCE
    dark = (incoherent or sample.strongest < LEAST_LEVELS) and sample.saturated.mean() <= MOST_SATURATED
    weak = share < LEAST_LIT and strength < WEAK_SIGMAS
    level = f"{sample.strongest:.2g} of 255 grey levels"
    seen = f"the fringes' modulation is {level}, {strength:.1f} times its noise"
    if (dark or weak) and (tiny := _tiny_part(sample)):
        yield tiny
        return
    if dark:
        words = f"{seen} (at least {DARK_SIGMAS:g})"
        excess = DARK_SIGMAS / max(strength, 0.01)
        yield Finding(FaultCause.PROJECTOR_DARK, words, excess)
        yield light_elsewhere(excess)
        return
    if weak:
        words = f"{seen} (at least {WEAK_SIGMAS:g})"
        factor = BEST_PEAK * 255.0 / max(2.0 * sample.strongest, 1.0)
        yield Finding(FaultCause.UNDEREXPOSED, words, WEAK_SIGMAS / strength, factor=factor)
        return
    if share < LEAST_LIT:
        words = f"the fringes light {100 * share:.2g} % of the image (at least {100 * LEAST_LIT:g} %)"
        yield Finding(FaultCause.NO_OVERLAP, words, LEAST_LIT / max(share, 1e-4))


def _tiny_part(sample: FrameSample) -> Finding | None:
    """Few pixels that do see fringes, of every set, where all others are dark."""
    strengths = [fit.modulation / sample.noise(fit.offset) for fit in sample.fits]
    seeing = np.min(strengths, axis=0) >= WEAK_SIGMAS
    seeing &= np.min([fit.modulation for fit in sample.fits], axis=0) >= LEAST_LEVELS
    if np.count_nonzero(seeing) < FEWEST_LIT:
        return None
    share = float(seeing.mean())
    words = f"the fringes light {100 * share:.2g} % of the image (at least {100 * LEAST_LIT:g} %)"
    advice = (
        "see whether the part is as large as it should be (a mesh is in mm), nearer, and where camera and "
        "projector both look"
    )
    return Finding(FaultCause.NO_OVERLAP, words, LEAST_LIT / share, advice)


def _saturation(sample: FrameSample) -> Finding | None:
    share = float(sample.saturated[sample.lit].mean())
    if share <= MOST_SATURATED:
        return None
    words = f"{100 * share:.0f} % of the lit pixels are saturated (at most {100 * MOST_SATURATED:g} %)"
    return Finding(FaultCause.SATURATED, words, share / MOST_SATURATED, factor=_dimming(sample))


def _dimming(sample: FrameSample) -> float:
    """The factor of the exposure by which the brightest lit pixels reach `BEST_PEAK` of full scale, about.

    A fringe that swings from dark to p times full scale is saturated for the share s of its phases with
    1/p = (1 + cos πs)/2. Where all images of a pixel are saturated nothing tells by how much.
    """
    levels = sample.spread[:, sample.lit]
    mean = levels.mean(axis=0)
    brightest = levels[:, mean >= np.percentile(mean, BRIGHTEST_PERCENT)]
    share = float(np.mean(brightest >= sample.recording.grey * sample.errors.saturation))
    within = 0.5 + 0.5 * math.cos(math.pi * share)
    return min(max(BEST_PEAK * within, LEAST_DIMMING), MOST_DIMMING)


def _exposure(sample: FrameSample) -> Finding | None:
    peak = float(np.percentile(sample.spread.max(axis=0)[sample.lit], 98)) / 255.0
    if peak >= LEAST_PEAK:
        return None
    words = f"the brightest parts reach {100 * peak:.1f} % of full scale (at least {100 * LEAST_PEAK:g} %)"
    # Without black level and the noise of single frames, which peaks contain.
    fringes = 2.0 * float(np.percentile(sample.widest.modulation[sample.lit], 98)) / 255.0
    factor = BEST_PEAK / max(fringes, 1e-3)
    return Finding(FaultCause.UNDEREXPOSED, words, LEAST_PEAK / max(peak, 1e-3), factor=factor)


def _ambient(sample: FrameSample) -> Finding | None:
    if not sample.measured.any():
        return None
    fit = sample.widest
    other = float(np.median((fit.offset - fit.modulation)[sample.measured]))
    fringes = float(np.median(fit.modulation[sample.measured]))
    if other <= max(MOST_AMBIENT * fringes, LEAST_AMBIENT):
        return None
    words = (
        f"{other:.0f} grey levels of light do not change with the fringes, whose modulation is "
        f"{fringes:.0f}; noise is {math.sqrt(1.0 + other / fringes):.1f} times as large as without (at most "
        f"{math.sqrt(1.0 + MOST_AMBIENT):.1f})"
    )
    # Without it they reach twice their modulation, and may be exposed for longer.
    peak = 2.0 * float(np.percentile(fit.modulation[sample.measured], 98)) / 255.0
    return Finding(
        FaultCause.AMBIENT, words, other / fringes / MOST_AMBIENT, factor=max(BEST_PEAK / peak, 1.0)
    )


def _response(sample: FrameSample) -> Finding | None:
    plan = sample.recording.plan
    errors = sample.errors.sets[plan.finest_set()]
    of_waves = [
        float(np.nan_to_num(np.hypot(*one.harmonics[:2]))) for one in sample.errors.sets if one.images > 3
    ]
    if of_waves and max(of_waves) > MOST_HARMONICS:
        words = (
            f"harmonics of the response are {100 * max(of_waves):.0f} % of the fringes (at most "
            f"{100 * MOST_HARMONICS:g} %)"
        )
        return Finding(FaultCause.RESPONSE, words, max(of_waves) / MOST_HARMONICS)
    by_power_law, seen = float(np.nan_to_num(errors.harmonic_rad)), max(ripples(sample), default=0.0)
    # Three images do not tell a second harmonic, as of a power law, from others.
    if plan.fringes[plan.finest_set()].images > 3 and seen > MUCH_BENT * by_power_law:
        what = f"harmonics that no power law explains ({by_power_law:.3f} rad)"
        return _phase_error(sample, FaultCause.HARMONICS, seen, LEAST_HARMONIC_RAD, what)
    rad = max(by_power_law, seen)
    return _phase_error(sample, FaultCause.RESPONSE, rad, LEAST_HARMONIC_RAD, "harmonics of the response")


def _flicker(sample: FrameSample) -> Finding | None:
    plan, fit = sample.recording.plan, sample.widest
    errors = sample.errors.sets[plan.finest_set()]
    if not sample.measured.any():
        return None
    scatter = _scatter_of_gains(sample)
    # Where a scene is even, all its pixels are rounded alike.
    rounding = float(sample.recording.grey) / math.sqrt(12.0) / float(np.median(fit.offset[sample.measured]))
    limit = max(MOST_FLICKER, rounding)
    if scatter > limit:
        words = f"frames differ in brightness by {100 * scatter:.1f} % RMS (at most {100 * limit:.2g} %)"
        return Finding(FaultCause.FLICKER, words, scatter / limit)
    if math.isnan(errors.gain_first):
        return None
    offset = float(np.median(fit.offset[sample.measured] / fit.modulation[sample.measured]))
    power = max(float(errors.variance(offset)) - np.nan_to_num(errors.harmonic_rad) ** 2, 0.0)
    return _phase_error(
        sample, FaultCause.FLICKER, math.sqrt(power), LEAST_FLICKER_RAD, "frames of unequal brightness"
    )


def _scatter_of_gains(sample: FrameSample) -> float:
    """Standard deviation of the frames' brightness, as a share.

    A sinusoid fitted to the N images of a set takes three of their N gains with it; N - 3 are left in the
    residuals, and two are seen where pixels of all phases are compared. Sets of three are compared together.
    """
    total, freedom = 0.0, 0
    for k, fringe in enumerate(sample.recording.plan.fringes):
        gains = _gains_left(sample, k) if fringe.images > 3 else None
        if gains is None:
            continue
        total, freedom = total + float(gains @ gains), freedom + fringe.images - 3
        first = sample.errors.sets[k].gain_first
        if not math.isnan(first):
            total, freedom = total + 2.0 * first**2 / fringe.images, freedom + 2
    if freedom >= LEAST_FREEDOM:
        return math.sqrt(total / freedom)
    # Gains ε_n of N frames that are independent: the mean of |Σ ε_n exp(iδ_n)|² is N times their variance.
    known = [one.gain_first**2 / one.images for one in sample.errors.sets if not math.isnan(one.gain_first)]
    return math.sqrt(np.mean(known)) if known else _scatter_without_fringes(sample)


def _scatter_without_fringes(sample: FrameSample) -> float:
    """The same by the means of frames whose fringes are so weak that these hardly depend on them."""
    plan, used = sample.recording.plan, sample.measured
    finest = plan.finest_set()
    fit = sample.fits[finest]
    if plan.fringes[finest].stripes < MANY_STRIPES or not used.any():
        return 0.0
    if np.median(fit.modulation[used] / np.maximum(fit.offset[used], 1.0)) > FAINT:
        return 0.0
    levels = sample.spread[plan.set_starts[finest] : plan.set_starts[finest + 1], used].mean(axis=1)
    return float(levels.std(ddof=1) / levels.mean())


def _gains_left(sample: FrameSample, k: int) -> Floats | None:
    """Gain (N,) of each frame of a set that the fit of a sinusoid leaves, beside harmonics of the response.

    None where the pixels' phases are few or unevenly spread, so that harmonics look like gains.
    """
    fit, plan = sample.fits[k], sample.recording.plan
    used = np.flatnonzero(sample.measured)
    used = used[:: max(1, len(used) // GAIN_PIXELS)]
    offset, modulation, phase = (part.ravel()[used] for part in (fit.offset, fit.modulation, fit.phase))
    if len(phase) < LEAST_RIPPLED or unevenness(phase, np.full(phase.shape, True)) > MOST_UNEVEN:
        return None
    frames = sample.spread[plan.set_starts[k] : plan.set_starts[k + 1]]
    images = frames.reshape(len(frames), -1)[:, used]
    angles = phase - plan.fringes[k].phase_shifts()[:, None]
    left = images - offset - modulation * np.cos(angles)
    waves = [modulation * wave for wave in harmonic_waves(angles)]
    per_offset = offset / (offset @ offset)
    gains, shares = left @ per_offset, [wave @ per_offset for wave in waves]
    rests = np.stack(
        [(wave - share[:, None] * offset).ravel() for wave, share in zip(waves, shares, strict=True)]
    )
    strengths = np.linalg.lstsq(rests @ rests.T, rests @ left.ravel(), rcond=1e-6)[0]
    return np.asarray(gains - strengths @ np.asarray(shares))


def _phase_error(
    sample: FrameSample, cause: FaultCause, rad: float, least_rad: float, what: str
) -> Finding | None:
    """An error of the phase that matters beside the noise."""
    if not sample.measured.any() or not rad > least_rad:
        return None
    fit, steps = sample.widest, sample.recording.plan.fringes[sample.recording.plan.finest_set()].images
    offset = float(np.median(fit.offset[sample.measured]))
    modulation = float(np.median(fit.modulation[sample.measured]))
    noise = float(
        phase_uncertainty(math.sqrt(float(sample.errors.noise.variance(offset))), modulation, steps)
    )
    limit = max(least_rad, noise)
    if rad <= limit:
        return None
    words = (
        f"{what} shift the phase by {rad:.3f} rad RMS, where noise does by {noise:.3f} (at most {limit:.3f})"
    )
    return Finding(cause, words, rad / limit)


def _motion(sample: FrameSample) -> Finding | None:
    """Displacement between the offsets of the fringe sets, which show the same scene."""
    moved = displacements_px(sample)
    certain = [shift if shift > SHIFT_SIGMAS * sigma else 0.0 for shift, sigma in moved]
    worst = max(certain, default=0.0)
    if worst <= MOST_SHIFT_PX:
        return None
    words = (
        f"the scene moved by {worst:.2f} px between fringe sets 1 and {certain.index(worst) + 2} "
        f"(at most {MOST_SHIFT_PX:g} px)"
    )
    return Finding(FaultCause.VIBRATION, words, worst / MOST_SHIFT_PX)


def displacements_px(sample: FrameSample) -> list[tuple[float, float]]:
    """Measure how far the scene is displaced in each fringe set beside the first."""
    first, *others = sample.offsets_in_tiles
    return [_displacement(first, other) for other in others]


def _displacement(one: Floats, other: Floats) -> tuple[float, float]:
    """Displacement in px between pictures (T, rows, columns), and its uncertainty, by least squares."""
    v, u = (np.gradient(one, axis=k)[:, 1:-1, 1:-1] for k in (1, 2))
    inner, change = one[:, 1:-1, 1:-1], (other - one)[:, 1:-1, 1:-1]
    basis = np.stack([u.ravel(), v.ravel(), inner.ravel(), np.ones(inner.size)], axis=1)
    normal = basis.T @ basis + 1e-9 * np.eye(4)
    best = np.linalg.solve(normal, basis.T @ change.ravel())
    left = change.ravel() - basis @ best
    known = np.linalg.inv(normal)[:2, :2] * left.var()
    return float(np.hypot(*best[:2])), float(np.sqrt(np.trace(known)))
