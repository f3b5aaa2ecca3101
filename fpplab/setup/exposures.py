"""Which exposures a plan takes of a scene, so that the most pixels are measured well in the time there is.

A ladder of exposures of white, black and two images of the finest fringes tells the light of every pixel, the
contrast of the fringes and the camera's noise. What a set of exposures leaves of the noise then follows as
`fpplab.phase.exposures` merges them. All sets of up to four exposures of a grid are tried.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations

import numpy as np

from fpplab.acquisition.acquire import expose
from fpplab.acquisition.timing import planned_timing
from fpplab.calibration.model import Calibration
from fpplab.core.conventions import TWO_PI, Axis, Floats, Image, Lattice, Mask, axis_length, raw_per_grey
from fpplab.core.errors import ConfigError, DataError
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Timed
from fpplab.patterns.fringe_sets import PatternSet
from fpplab.patterns.fringes import make_patterns, uniform_patterns
from fpplab.patterns.plan import MaskRules, Plan
from fpplab.phase.code_table import code_table, code_uncertainty
from fpplab.phase.coded_axes import axes_by_codes, sets_of_axis
from fpplab.phase.exposures import ExposureModel, merge_frames
from fpplab.phase.limits import CODES, NOISE
from fpplab.setup.live.expectation import RigGeometry, WorkingPoint
from fpplab.setup.live.exposure import ExposureLimits
from fpplab.setup.live.patterns import as_fine_fringes


@dataclass(frozen=True)
class ExposureSearchLimits:
    """Limits of the search; all chosen."""

    ladder: float = 4.0  # ratio of the exposures that the scene is looked at with
    max_saturated: float = 1e-4  # share of pixels that the shortest of them may show saturated
    max_exposures: int = 4  # in a plan
    grid: int = 14  # exposures that are combined
    min_ratio: float = 1.4  # of neighbours among them
    pixels: int = 1500  # that are predicted, of those that see the projector
    min_sigmas: float = 6.0  # of the difference of white and black at a pixel that sees the projector
    completeness: float = 0.005  # that is given up for less noise
    noise_range: tuple[float, float] = (1e-3, 0.5)  # of levels over the modulation that codes are tried with


SEARCH = ExposureSearchLimits()


@dataclass(frozen=True, eq=False)
class SceneLight:
    """What pixels see of the projector."""

    offset: Floats  # (P,) mean of white and black above the camera's black, raw levels per s
    modulation: Floats  # (P,) half of their difference, raw levels per s
    contrast: float  # of the finest fringes, as a share of that of white and black
    model: ExposureModel  # of the camera
    bits: int  # of its levels
    pixels: int  # of the image that see the projector

    @classmethod
    def of(
        cls, frames: Sequence[Image], bits: int, exposures_s: Sequence[float], turn_rad: float
    ) -> SceneLight:
        """Measure it: white, black and two fringes that are shifted by an angle, at every exposure."""
        merged, levels, model = merge_frames(frames, bits, exposures_s, "the scene")
        unit = raw_per_grey(16) / levels.headroom / raw_per_grey(bits)
        scale = levels.scales[0] * max(exposures_s)
        white, black, first, second = (
            np.where(frame == np.iinfo(frame.dtype).max, np.inf, (frame / unit - model.offset) / scale)
            for frame in merged
        )
        noise = np.sqrt(model.noise.variance(np.maximum(scale * np.minimum(white, 1e12), 0.0))) / scale
        lit = ~(white - black < SEARCH.min_sigmas * noise)
        if lit.sum() < NOISE.min_pixels:
            raise DataError("no part of the scene sees the projector, even at the longest exposure in time")
        clear = lit & np.isfinite(white + first + second)
        half = 0.5 * (white - black)
        ratio = np.square((first - second)[clear] / half[clear]) - 2.0 * np.square(noise[clear] / half[clear])
        contrast = math.sqrt(max(float(ratio.mean()), 0.0) / 2.0) / abs(math.sin(0.5 * turn_rad))
        picked = np.flatnonzero(lit)[:: max(1, int(lit.sum()) // SEARCH.pixels)]
        offset = 0.5 * (white + black).ravel()[picked]
        return cls(offset, half.ravel()[picked], min(contrast, 1.0), model, bits, int(lit.sum()))

    def expected(
        self, plan: Plan, size: tuple[int, int], exposures_s: Sequence[float]
    ) -> tuple[Mask, Floats]:
        """Compute which pixels are measured, and the noise of their coordinate along the first axis in px."""
        axis, fringes = plan.axes[0], plan.fringe_part
        measured, information = np.isfinite(self.offset), np.zeros(len(self.offset))
        if codes := sets_of_axis(plan, axis, with_fringes=axis in axes_by_codes(plan, size)):
            sets = tuple(plan.sets[k] for k in codes)
            measured, noise = self._code_noise(plan.masks, sets, (axis, size), exposures_s)
        if fringes is None or axis in axes_by_codes(plan, size):
            uncertainties = _tabulate_code_uncertainty(sets, axis, size)
            return measured, np.where(np.isfinite(noise), np.interp(noise, *uncertainties), np.inf)
        length, finest = axis_length(size, axis), fringes.finest.stripes
        for k in fringes.sets_along(axis):
            fringe = fringes.fringes[k]
            contrast = self.contrast ** ((fringe.stripes / finest) ** 2)
            usable, variance = self._phase_variance(plan.masks, fringe.images, contrast, exposures_s)
            measured &= usable
            information += np.square(TWO_PI * fringe.stripes / length / fringe.phase_noise) / variance
        return measured, 1.0 / np.sqrt(np.maximum(information, 1e-30))

    def _phase_variance(
        self, masks: MaskRules, steps: int, contrast: float, exposures_s: Sequence[float]
    ) -> tuple[Mask, Floats]:
        """Which pixels are measured, and the variance of a sample over modulation² that their phase has."""
        start = TWO_PI * np.random.default_rng(0).random(len(self.offset))  # the phase of a pixel is any
        theta = start[:, None] + TWO_PI * np.arange(steps) / steps
        cosine, sine = np.cos(theta), np.sin(theta)
        fringe = np.where(np.isfinite(self.modulation), contrast * self.modulation, 0.0)
        light = np.where(np.isfinite(self.offset), self.offset, np.inf)[:, None] + fringe[:, None] * cosine
        used, variance = self._merged(light, exposures_s)
        slopes = np.where(used, sine**2, 0.0)
        spread = (slopes * variance).sum(axis=1) / np.maximum(slopes.sum(axis=1), 1e-30)
        loss = _loss(used, cosine, sine)
        usable = used.sum(axis=1) >= NOISE.min_samples
        usable &= (loss <= NOISE.max_saturation_loss) & self._is_bright(masks, fringe, spread)
        square = np.square(np.where(usable, fringe, 1.0))
        return usable, np.where(usable, spread * np.where(usable, loss, 1.0) / square, np.inf)

    def _code_noise(
        self,
        masks: MaskRules,
        sets: tuple[PatternSet, ...],
        place: tuple[Axis, tuple[int, int]],
        exposures_s: Sequence[float],
    ) -> tuple[Mask, Floats]:
        """Which pixels see all images of codes, and the noise of their levels over the modulation."""
        length = axis_length(place[1], place[0])
        at = (length - 1.0) * np.random.default_rng(0).random(len(self.offset))  # a pixel sees any coordinate
        shown = [each.light(step, at, length) for each in sets for step in range(each.images)]
        half = np.where(np.isfinite(self.modulation), self.modulation, 0.0)
        swing = half[:, None] * (2.0 * np.stack(shown, axis=1) - 1.0)
        light = np.where(np.isfinite(self.offset), self.offset, np.inf)[:, None] + swing
        used, variance = self._merged(light, exposures_s)
        spread = variance.mean(axis=1)
        usable = used.all(axis=1) & self._is_bright(masks, half, spread)
        return usable, np.where(usable, np.sqrt(spread) / np.where(usable, half, 1.0), np.inf)

    def _merged(self, light: Floats, exposures_s: Sequence[float]) -> tuple[Mask, Floats]:
        """Which samples any exposure has unsaturated, and the variance of all that have it together."""
        # light (P, N) levels per s
        noise, weight = self.model.noise, np.zeros_like(light)
        for exposure_s in exposures_s:
            levels = exposure_s * light
            usable = self.model.black + levels < self.model.saturation
            levels = np.where(usable, levels, 0.0)
            weight += np.where(usable, exposure_s**2 / noise.variance(np.maximum(levels, 0.0)), 0.0)
        used = weight > 0.0
        return used, np.where(used, 1.0 / np.maximum(weight, 1e-30), 0.0)

    def _is_bright(self, masks: MaskRules, modulation: Floats, spread: Floats) -> Mask:
        """Whether the plan's rules take the modulation, at the scale that merging gives it."""
        noise, grey = self.model.noise, raw_per_grey(self.bits)
        rising = noise.per_level * self.offset
        scale = (
            0.5 * (rising + np.sqrt(rising**2 + 4.0 * spread * noise.constant)) / np.maximum(spread, 1e-30)
        )
        level, offset = scale * modulation, scale * self.offset + self.model.offset
        return np.asarray((level >= masks.modulation_min * grey) & (level >= masks.contrast_min * offset))


@lru_cache(maxsize=8)  # one plan is asked for many exposures
def _tabulate_code_uncertainty(
    sets: tuple[PatternSet, ...], axis: Axis, size: tuple[int, int]
) -> tuple[Floats, Floats]:
    # returns noise of levels over the modulation, and the uncertainty in px that it gives
    table = code_table(sets, axis, size, Lattice.SQUARE, CODES.usual_blur_px)
    noise = np.geomspace(*SEARCH.noise_range, SEARCH.grid)
    return noise, np.array([code_uncertainty(table, each, CODES.apart_px)[0] for each in noise])


def _loss(used: Mask, cosine: Floats, sine: Floats) -> Floats:
    """Variance of the phase by the samples used, relative to that from all, (P,)."""
    count = np.maximum(used.sum(axis=1), 1)
    c, s = (used * cosine).sum(axis=1), (used * sine).sum(axis=1)
    cc = (used * cosine**2).sum(axis=1) - c * c / count
    ss = (used * sine**2).sum(axis=1) - s * s / count
    cs = (used * cosine * sine).sum(axis=1) - c * s / count
    determinant = cc * ss - cs * cs
    return np.where(determinant > 1e-6, 0.5 * cosine.shape[1] * cc / np.maximum(determinant, 1e-6), np.inf)


@dataclass(frozen=True)
class ExposureChoice:
    """Exposures, and what is expected of them."""

    exposures_s: tuple[float, ...]  # in s, the shortest first
    seconds: float  # that the plan's frames take
    completeness: float  # share of the pixels that see the projector
    sigma_px: float  # RMS noise of the coordinate along the first axis


def choose_exposures(
    light: SceneLight,
    plan: Plan,
    size: tuple[int, int],
    limits: ExposureLimits,
    seconds: float,
    other_s: float = 0.0,
    most: int = SEARCH.max_exposures,
) -> ExposureChoice:
    """Try all sets of exposures of a grid; `other_s` is the time of a frame beside its exposure."""
    longest = longest_exposure(plan, limits, seconds, other_s)
    highest = np.max((light.offset + light.modulation)[np.isfinite(light.offset)])
    room = light.model.saturation - light.model.black
    shortest = min(max(limits.exposure_s[0], limits.period_s, 0.9 * room / highest), longest)
    count = min(SEARCH.grid, 1 + math.ceil(math.log(longest / shortest) / math.log(SEARCH.min_ratio)))
    grid = sorted({limits.on_grid(float(f"{each:.3g}")) for each in np.geomspace(shortest, longest, count)})
    # The finest set decides the noise, and that of fewest steps what saturated samples are missed.
    part = plan
    if plan.fringe_part is plan:
        along = plan.sets_along(plan.axes[0])
        deciding = {along[-1], min(along, key=lambda k: plan.fringes[k].images)}
        chosen_sets = tuple(plan.fringes[k] for k in deciding)
        part = plan.model_copy(update={"fringes": chosen_sets, "guided_axis": None})
    choices = [
        _expected(light, part, size, chosen, needed)
        for several in range(1, most + 1)
        for chosen in combinations(grid, several)
        if (needed := plan.images * sum(each + other_s for each in chosen)) <= seconds * (1.0 + 1e-3)
    ]
    enough = max(choice.completeness for choice in choices) - SEARCH.completeness
    best = min((c for c in choices if c.completeness >= enough), key=lambda choice: choice.sigma_px)
    return _expected(light, plan, size, best.exposures_s, best.seconds)


def _expected(
    light: SceneLight, plan: Plan, size: tuple[int, int], exposures_s: tuple[float, ...], seconds: float
) -> ExposureChoice:
    measured, sigma = light.expected(plan, size, exposures_s)
    rms = float(np.sqrt(np.mean(sigma[measured] ** 2))) if measured.any() else math.inf
    return ExposureChoice(exposures_s, seconds, float(measured.mean()), rms)


def longest_exposure(plan: Plan, limits: ExposureLimits, seconds: float, other_s: float) -> float:
    """Give the longest exposure that takes all images in the time."""
    longest = min(limits.exposure_s[1], seconds / plan.images - other_s)
    if longest < max(limits.exposure_s[0], limits.period_s):
        shortest_s = plan.images * (max(limits.exposure_s[0], limits.period_s) + other_s)
        raise ConfigError(
            f"--seconds is {seconds:g}: the plan's {plan.images} images need at least {shortest_s:.3g}"
        )
    return limits.on_grid(longest)


def measure_light(rig: Rig, plan: Plan, seconds: float) -> tuple[SceneLight, ExposureLimits, float]:
    """Take the ladder of exposures on an open rig."""
    # returns the light, the devices' limits, and s of a frame beside its exposure
    plan.refuse_set_exposures("the choice of exposures")
    caps = rig.projector.caps
    fringes = plan.fringe_part or as_fine_fringes(plan, caps.size)
    finest = fringes.finest
    limits = ExposureLimits.by_devices(rig.camera.caps, caps, plan)
    patterns = make_patterns(fringes, caps.size, caps.lattice)
    steps = fringes.finest_images
    half = finest.images // 2
    shown = [*uniform_patterns([255, 0], caps.size), patterns[steps[0]], patterns[steps[half]]]
    rig.projector.load(shown)
    settings = rig.camera.configure(
        rig.camera_settings(max(limits.exposure_s[0], plan.exposure_s), plan.bits)
    )
    other_s = planned_timing(rig, plan, shown, settings.exposure_s).period_s - settings.exposure_s
    exposure_s = longest_exposure(plan, limits, seconds, other_s)
    frames, exposures_s = list[Image](), list[float]()
    now = _clock_of(rig)
    while True:
        settings = rig.camera_settings(exposure_s, plan.bits)
        began = now()
        with closing(expose(rig, shown, settings, plan)) as shots:
            taken = list(shots)
        if not frames:  # with the longest exposure, which allows the fewest patterns in an image of a display
            other_s = max(other_s, (now() - began) / len(shown) - taken[0].settings.exposure_s)
        frames += [shot.image for shot in taken]
        exposures_s.append(taken[0].settings.exposure_s)
        saturated = float((taken[0].image >= 2**settings.bits - 1).mean())
        shortest_s = max(limits.exposure_s[0], limits.period_s)
        if (saturated <= SEARCH.max_saturated and len(exposures_s) > 1) or exposure_s <= shortest_s:
            break
        exposure_s = max(limits.on_grid(exposure_s / SEARCH.ladder), shortest_s)
    shifts = finest.phase_shifts()
    light = SceneLight.of(frames, settings.bits, exposures_s, float(shifts[half] - shifts[0]))
    return light, limits, other_s


def _clock_of(rig: Rig) -> Callable[[], float]:
    """The time in s that frames take, which is 0 where a simulation computes them."""
    if rig.simulation is None:
        return time.monotonic
    return rig.simulation.now_s if isinstance(rig.simulation, Timed) else lambda: 0.0


def um_per_px(calibration: Calibration, plan: Plan) -> float:
    """Give what a pixel of the first axis is along the ray, where the devices' middle rays meet."""
    geometry = RigGeometry(calibration)
    along = WorkingPoint(geometry, plan, geometry.meeting_mm).px_per_mm[..., 0 if plan.axes[0] == "x" else 1]
    return 1e3 / float(np.nanmedian(along))
