"""Surfaces of the scene light each other (interreflection)."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import scipy

from fpplab.calibration.model import Calibration
from fpplab.core.config import Positive
from fpplab.core.conventions import TWO_PI, Axis, Floats, Mask, axis_length
from fpplab.core.drawing import ERROR_COLOURS
from fpplab.core.errors import ConfigError
from fpplab.core.robust import robust_spread
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.fringe_shape import harmonics_of_power_law_rad, phase_deviations
from fpplab.diagnosis.limits import CountLimit, LimitsSection, ShareLimit
from fpplab.diagnosis.pictures import draw_sample_map
from fpplab.diagnosis.points import DirectionLimits, changes_along_image
from fpplab.diagnosis.sample import MEDIAN, FrameSample
from fpplab.phase import Decoded
from fpplab.phase.fine_plan import error_ratio, fine_plan
from fpplab.phase.limits import FINE_PLAN

BLOCK = 8  # side of the blocks in which neighbours are compared, in pixels of the sample (chosen)
COAT = "coat or turn the part so that its faces do not light each other, or cover objects next "
"to it"


class InterreflectionLimits(LimitsSection):
    """How much light may come by way of other surfaces."""

    max_phase_error_rad: Positive = 0.055
    """RMS phase error of wide fringes in rad that neighbours share and no phase explains. Measured: two
    captures of a real rig without such light reach 0.046."""
    min_known_share: ShareLimit = 0.5
    """Share of a block's pixels whose phase error is known. Chosen."""
    min_region_sigmas: Positive = 4.0
    """Deviation of a block of pixels from which it is beyond noise. Derived: of 1000 blocks noise reaches it
    in 0.06."""
    min_region_blocks: CountLimit = 4
    """Blocks next to each other that are a region. Chosen: edges of a part have fewer."""
    max_mirrored_share: Positive = 0.03
    """Share of the image with fringes in which the coordinate runs backwards. Measured on benches."""
    min_directed_share: Positive = 0.25
    """Share of a block's pixels whose coordinate is known. Chosen."""
    min_directed_blocks: CountLimit = 8
    """Such blocks. Chosen."""
    min_backward_sigmas: Positive = 3.0
    """Standard uncertainties by which the change in a block is below zero. Chosen."""
    depth_margin_mm: Positive = 5.0
    """What is added to the depths of the points for another plan. Chosen: errors of theirs are smaller."""
    min_gain: Positive = 2.0
    """How many times smaller another plan makes the error for it to be offered. Chosen."""
    useless_mirrored_share: Positive = 0.3
    """Share that runs backwards above which points are useless. Chosen: a third stands where nothing is."""
    useless_phase_error: Positive = 13.0
    """Error of the phase as a multiple of its noise above which points are of no use. Measured: on 33
    benches the estimate was nearly always within a factor of two of the true error."""


@dataclass(frozen=True)
class _Region:
    """Where wide fringes contradict fine ones, and what of that is in the coordinate of these."""

    middle_px: tuple[int, int]  # column and row in the image
    error_px: float  # RMS
    stated_px: float  # RMS of the uncertainty that is stated there

    @property
    def excess(self) -> float:
        return self.error_px / self.stated_px


def _find_stray_light(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    """Light that arrives by way of other surfaces, with the phase of those."""
    sample = evidence.frames
    shared = {k: _shared_deviations(sample, k, e, d) for k, e, d in phase_deviations(sample)}
    worst = max(map(_stray_rad, shared.values()), default=0.0)
    # Flicker and harmonics of the finest set look the same.
    explained_rad = harmonics_of_power_law_rad(sample)
    limit = max(evidence.limits.of(InterreflectionLimits).max_phase_error_rad, 1.5 * explained_rad)
    if worst > limit:
        text = (
            f"the phase of wide fringes differs from that of fine ones by {worst:.2f} rad RMS from place to "
            f"place (at most {limit:.2f}): part of the light comes by way of other surfaces"
        )
        yield Finding(INTERREFLECTION, text, worst / limit)
    elif (region := _worst_region(evidence, shared)) is not None and region.excess > 1.0:
        column, row = region.middle_px
        text = (
            f"about pixel {column}, {row} wide and fine fringes contradict each other beyond noise, as where "
            f"light comes by way of other surfaces; it costs {_in_um(evidence, region.error_px)}, beside "
            f"{_in_um(evidence, region.stated_px)} that are stated"
        )
        yield Finding(INTERREFLECTION, text, region.excess)


def _worst_region(evidence: Evidence, shared: Mapping[int, Floats]) -> _Region | None:
    """Find where light by way of other surfaces costs most beside what is stated, by the finest wide set."""
    plan, decoded = evidence.frames.recording.plan, evidence.decoded
    along = [k for k in shared if plan.fringes[k].axis == plan.axes[0]]
    if decoded is None or not along:
        return None
    k = max(along, key=lambda k: plan.fringes[k].stripes)
    regions = _regions(evidence.frames, decoded, k, shared[k])
    return max(regions, key=lambda region: region.excess, default=None)


def _in_um(evidence: Evidence, px: float) -> str:
    if not evidence.has_points:
        return f"{px:.3f} px of the projector"
    return f"{1e3 * px / evidence.points.px_per_mm_of_depth['xy'.index(evidence.plan.axes[0])]:.1f} µm"


def _stray_rad(halves: Floats) -> float:
    """RMS that neighbours share: noise is independent in the medians of two halves, and edges are few."""
    whole = np.isfinite(halves).all(axis=0)
    if whole.sum() < 2 * BLOCK:
        return 0.0
    return math.sqrt(max(float(np.mean(np.prod(halves[:, whole], axis=0))), 0.0))


def _shared_deviations(sample: FrameSample, k: int, expected: Floats, deviation: Floats) -> Floats:
    """Median deviation of two halves of every block (2, rows, columns), without what the phase explains."""
    # Harmonics and gains of frames repeat with the phase.
    finite = np.isfinite(deviation)
    orders = (0, 1, sample.recording.plan.fringes[k].images)
    waves = np.concatenate([[np.cos(m * expected[finite]), np.sin(m * expected[finite])] for m in orders])
    residuals = np.full(deviation.shape, np.nan)
    strengths = np.linalg.lstsq(waves.T, deviation[finite], rcond=1e-6)[0]
    residuals[finite] = deviation[finite] - strengths @ waves
    blocks = _in_blocks(residuals)
    # Where light of two surfaces is mixed, many pixels are masked.
    min_share = sample.limits.of(InterreflectionLimits).min_known_share
    medians = np.full((2, *blocks.shape[:2]), np.nan)
    for n in range(2):
        half = blocks[..., n::2]
        whole = np.isfinite(half).mean(axis=-1) >= min_share
        medians[n][whole] = np.nanmedian(half[whole], axis=-1)
    return medians


def _in_blocks(values: Floats) -> Floats:
    """Values (rows, columns) by square blocks, (block rows, block columns, pixels)."""
    rows, columns = (n // BLOCK for n in values.shape)
    blocks = values[: rows * BLOCK, : columns * BLOCK].reshape(rows, BLOCK, columns, BLOCK)
    return np.asarray(blocks.transpose(0, 2, 1, 3).reshape(rows, columns, -1))


def _regions(sample: FrameSample, decoded: Decoded, k: int, halves: Floats) -> Iterator[_Region]:
    limits, plan = sample.limits.of(InterreflectionLimits), sample.recording.plan
    length = axis_length(sample.recording.projector_size, plan.fringes[k].axis)
    periods = np.array([length / plan.fringes[n].stripes for n in (k, plan.finest_set(plan.fringes[k].axis))])
    px_per_rad = periods[0] / TWO_PI * (periods[1] / periods[0]) ** FINE_PLAN.error_power
    common = decoded.sigma_phase_error
    total = decoded.sigma if common is None else np.hypot(decoded.sigma, common)
    stated = _in_blocks(np.asarray(total[:: sample.step, :: sample.step], np.float64))
    mean, known = halves.mean(axis=0), np.isfinite(halves).all(axis=0)
    if known.sum() < 2 * BLOCK:
        return
    noise = robust_spread((halves[0] - halves[1])[known], 0.0) / 2.0
    for sign in (-1.0, 1.0):
        contradicts = known & (sign * mean > limits.min_region_sigmas * noise)
        count, numbers = cv2.connectedComponents(contradicts.astype(np.uint8))
        for n in range(1, count):
            own = numbers == n
            if own.sum() >= limits.min_region_blocks:
                row, column = np.mean(np.argwhere(own) + 0.5, axis=0) * BLOCK * sample.step
                error_px = px_per_rad * math.sqrt(np.mean(mean[own] ** 2))
                of_blocks = math.sqrt(np.nanmean(stated[own] ** 2))
                yield _Region((round(column), round(row)), error_px, of_blocks)


def _find_mirrors(evidence: Evidence, findings: Sequence[Finding]) -> Iterator[Finding]:
    """Mirrored light, and whether light by way of other surfaces makes the points useless."""
    sample, limits = evidence.frames, evidence.limits.of(InterreflectionLimits)
    calibration = evidence.points.calibration
    backward = {axis: _find_backward_areas(sample, calibration, axis) for axis in sample.coordinates}
    share = max((part for _, part in backward.values()), default=0.0)
    candidates = [finding for finding in findings if finding.cause == INTERREFLECTION]
    if share > limits.max_mirrored_share:
        text = (
            f"in {100 * share:.0f} % of the image with fringes the coordinate runs backwards (at most "
            f"{100 * limits.max_mirrored_share:g} %), as where light comes by way of a face that mirrors"
        )
        candidates.append(Finding(INTERREFLECTION, text, share / limits.max_mirrored_share))
    if not candidates:
        return
    worst = max(candidates, key=lambda finding: finding.excess)
    error = max((_phase_error(sample, axis, where) for axis, (where, _) in backward.items()), default=0.0)
    ruins = share >= limits.useless_mirrored_share or error >= limits.useless_phase_error
    advice = COAT if share > limits.max_mirrored_share else offer(evidence)
    more = f"; it makes errors some {error:.0f} times those of noise" if np.isfinite(error) and ruins else ""
    yield replace(worst, evidence=worst.evidence + more, advice=advice, ruins_points=ruins)


def offer(evidence: Evidence) -> str:
    """Offer a plan of fine fringes alone that suits these points and the noise of these frames."""
    sample, plan = evidence.frames, evidence.frames.recording.plan
    near, far = np.percentile(evidence.points.points[:, 2], (0.5, 99.5))
    margin = sample.limits.of(InterreflectionLimits).depth_margin_mm
    depth_mm = float(math.floor(near - margin)), float(math.ceil(far + margin))
    finest = plan.finest_set(plan.axes[0])
    noise = sample.phase_noise(finest) / plan.fringes[finest].phase_noise
    try:
        offered = fine_plan(evidence.points.calibration, depth_mm, noise=noise)
    except ConfigError as error:
        return f"{COAT}; a plan of fine fringes alone does not suit: {error}"
    ratio = error_ratio(plan, offered, sample.recording.projector_size)
    if ratio < sample.limits.of(InterreflectionLimits).min_gain:
        return COAT
    return (
        f"scan with fine fringes alone, of which {offered.images} images are expected to leave 1/{ratio:.0f} "
        f"of the error where walls meet: `fpplab plan fine --depth {depth_mm[0]:g} {depth_mm[1]:g} "
        f"--calibration FILE --out fine.yaml` writes the plan, and noise of these frames leaves its fringe "
        f"orders certain; or {COAT}"
    )


def _find_backward_areas(sample: FrameSample, calibration: Calibration, axis: Axis) -> tuple[Mask, float]:
    """Find where the coordinate runs against the calibration, and the share of the image where it does."""
    # No surface that both devices see shows that, but its image in another surface does.
    limits = sample.limits.of(InterreflectionLimits)
    side = 24  # of the blocks, in pixels of the sample (chosen): harmonics average out
    shares = changes_along_image(sample.coordinates[axis], calibration, axis, sample.step)
    height, width = sample.spread.shape[1:]
    rows, columns = (-(-n // side) for n in (height, width))
    whole = np.full((rows * side, columns * side), np.nan)
    whole[: shares.shape[0], : shares.shape[1]] = shares
    blocks = whole.reshape(rows, side, columns, side).transpose(0, 2, 1, 3).reshape(rows, columns, -1)
    used = np.isfinite(blocks).mean(axis=2) >= limits.min_directed_share
    back = np.zeros(used.shape, bool)
    if used.sum() >= limits.min_directed_blocks:
        min_change = sample.limits.of(DirectionLimits).min_change
        back[used] = _is_backward(blocks[used], min_change, limits.min_backward_sigmas)
    where = np.repeat(np.repeat(back, side, axis=0), side, axis=1)[:height, :width]
    return where, float(back.sum() / max(used.sum(), 1))


def _is_backward(blocks: Floats, min_change: float, min_sigmas: float) -> Mask:
    """Whether the typical change in each block (B, N) is clearly below zero."""
    middle = np.nanmedian(blocks, axis=1)
    scatter = np.nanmedian(np.abs(blocks - middle[:, None]), axis=1) / MEDIAN
    # The uncertainty of a median is 1.25 times that of a mean.
    uncertainty = 1.25 * scatter / np.sqrt(np.isfinite(blocks).sum(axis=1))
    return np.asarray(middle < -np.maximum(min_change, min_sigmas * uncertainty))


def _phase_error(sample: FrameSample, axis: Axis, backward: Mask) -> float:
    """Typical error of the phase of the finest fringes compared with its noise."""
    # Other light of the same fringes with another phase adds to them here and takes from them there, and
    # shifts their phase by as much. Points that mirrored light has made are wrong altogether.
    plan, used = sample.recording.plan, sample.measured
    sets = [k for k, fringe in enumerate(plan.fringes) if fringe.axis == axis]
    wide, finest = min(sets, key=lambda k: plan.fringes[k].stripes), plan.finest_set(axis)
    if wide == finest or not used.any():
        return 0.0
    fine, coarse = sample.fits[finest], sample.fits[wide]
    contrast = np.where(used, fine.modulation / np.where(used, coarse.modulation, 1.0), 0.0)
    window = 17  # in pixels of the sample (chosen)
    coverage = np.maximum(scipy.ndimage.uniform_filter(used.astype(np.float64), window), 1e-9)
    deviation = np.abs(
        contrast * coverage / np.maximum(scipy.ndimage.uniform_filter(contrast, window), 1e-9) - 1.0
    )
    return float(np.median(np.where(backward, np.inf, deviation)[used])) / MEDIAN / sample.phase_noise(finest)


def _draw(evidence: Evidence, _: Finding) -> Figure | None:
    sample = evidence.frames
    deviations = [deviation for _, _, deviation in phase_deviations(sample)]
    if not deviations:
        return None
    worst = max(deviations, key=lambda values: float(np.nanstd(values)))
    limit = max(float(np.nanpercentile(np.abs(worst), 98)), 0.05)
    return draw_sample_map(
        worst, sample, ERROR_COLOURS, (-limit, limit), "phase of wide − fine fringes in rad"
    )


INTERREFLECTION = FaultCause(
    key="interreflection",
    meaning="Surfaces of the scene light each other (interreflection).",
    remedy=f"{COAT}, or scan with fine fringes alone, of a plan that `fpplab plan fine` writes",
    measured="difference in phase between wide and fine fringes that neighbours share and no "
    "phase-dependent error explains, over the image, and in a region the error of the fine ones that "
    "follows from it; fraction of the image in which the coordinate runs "
    "opposite to the calibration, as in a mirror image",
    limit=f"{InterreflectionLimits().max_phase_error_rad:g} rad RMS; the uncertainty stated in a region; "
    f"{100 * InterreflectionLimits().max_mirrored_share:g} %",
    seen_in="coordinates",
    detectors=(
        Detector(DetectionStage.FRAMES, _find_stray_light),
        Detector(DetectionStage.REFLECTIONS, _find_mirrors, replaces=True),
    ),
    picture=Picture(Needs.FRAMES, _draw),
    outweighs_from={"harmonics": 1.0, "response": 1.0},
)
