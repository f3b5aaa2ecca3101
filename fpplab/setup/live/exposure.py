"""The exposure that uses the camera's range: as long as allowed, and gain only for what is then missing.

The level above black is proportional to exposure and gain, so one step leads to `ExposureGoals.peak`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Image, full_scale
from fpplab.devices import CameraCaps, CameraSettings, ProjectorCaps
from fpplab.diagnosis.sample import FrameSample, SampleLimits
from fpplab.patterns.plan import Plan


@dataclass(frozen=True)
class ExposureGoals:
    """What a good exposure is; all chosen."""

    peak: float = 0.88  # level that the brightest lit pixels are to reach, as a share of full scale
    tolerance: float = 0.03  # of the peak
    percentile: float = 99.5  # of the lit pixels that counts as the brightest: highlights may saturate
    min_above_black: float = 1e-3  # assumed of the brightest lit pixels, as a share of full scale
    saturated_factor: float = 0.25  # change of light where the peak is saturated, by an unknown factor
    max_ambient_share: float = 0.5  # of the peak by light that is not the projector's
    grid_tolerance: float = 0.01  # of a bit-plane period, by which an exposure may be rounded up


GOALS = ExposureGoals()


@dataclass(frozen=True)
class LightLevels:
    """How much of its range the camera uses."""

    peak: float  # level of the brightest lit pixels, as a share of full scale
    saturated: float  # share of the lit pixels that are saturated
    ambient: float | None = None  # light that does not change with the fringes, as a share of full scale
    black: float = 0.0  # the camera's level without light, as a share of full scale

    @property
    def is_saturated(self) -> bool:
        return self.saturated > 1.0 - GOALS.percentile / 100.0


@dataclass(frozen=True)
class ExposureLimits:
    """What the devices allow."""

    exposure_s: tuple[float, float]  # shortest and longest exposure, in s
    gain_db: tuple[float, float]  # lowest and highest gain, in dB
    period_s: float = 0.0  # exposures are whole multiples of this, in s; 0 where any will do
    of: str = "camera"  # who limits the longest exposure, for messages

    @classmethod
    def by_devices(cls, camera: CameraCaps, projector: ProjectorCaps, plan: Plan) -> ExposureLimits:
        shortest_s, longest_s = camera.exposure_s
        if plan.trigger == "stepped":
            return cls((shortest_s, longest_s), camera.gain_db, projector.period_s)
        shown_s = projector.bit_depths[max(projector.bit_depths)], projector.longest_s
        shortest_s = max(shortest_s, shown_s[0] - camera.readout_s)
        longest_shown_s = shown_s[1] - camera.readout_s
        return cls(
            (shortest_s, min(longest_s, longest_shown_s)),
            camera.gain_db,
            0.0,
            "camera" if longest_s <= longest_shown_s else "projector",
        )

    def on_grid(self, exposure_s: float) -> float:
        """Round an exposure down to whole bit-plane periods, of which there is one at least."""
        if self.period_s <= 0:
            return exposure_s
        return self.period_s * max(1, math.floor(exposure_s / self.period_s + GOALS.grid_tolerance))

    def stepped(self, exposure_s: float, factor: float) -> float:
        stepped_s = exposure_s * factor
        if self.period_s <= 0:
            return stepped_s
        steps = max(1, round(stepped_s / self.period_s))
        now = exposure_s / self.period_s
        if factor > 1.0:
            return self.period_s * max(steps, math.floor(now + GOALS.grid_tolerance) + 1)
        return self.period_s * max(0, min(steps, math.ceil(now - GOALS.grid_tolerance) - 1))


@dataclass(frozen=True)
class ExposureAdvice:
    """An exposure to take."""

    exposure_s: float  # in s
    gain_db: float  # in dB
    peak: float | None  # level that the brightest lit pixels will reach, as a share of full scale
    limits: tuple[str, ...]  # what limits the image, and what to do about it
    is_right: bool  # whether the present exposure needs no change


def levels_of_fringes(sample: FrameSample, black: float = 0.0) -> LightLevels | None:
    if not sample.lit.any():
        return None
    peaks, widest = sample.spread.max(axis=0)[sample.lit] / 255.0, sample.widest
    other = float(np.median((widest.offset - widest.modulation)[sample.lit])) / 255.0
    saturated = float(sample.saturated[sample.lit].mean())
    return LightLevels(
        float(np.percentile(peaks, GOALS.percentile)), saturated, max(other - black, 0.0), black
    )


def levels_of_image(image: Image, bits: int, black: float = 0.0) -> LightLevels:
    # image (height, width)
    levels: NDArray[np.floating[Any]] = image[::2, ::2].astype(np.float32) / full_scale(bits)
    lit = levels[levels >= SampleLimits().min_lit_share * np.percentile(levels, 99.9)]
    return LightLevels(float(np.percentile(lit, GOALS.percentile)), float((lit >= 1.0).mean()), None, black)


def advise_exposure(levels: LightLevels, now: CameraSettings, limits: ExposureLimits) -> ExposureAdvice:
    above = max(levels.peak - levels.black, GOALS.min_above_black)
    factor = GOALS.saturated_factor if levels.is_saturated else (GOALS.peak - levels.black) / above
    light = now.exposure_s * _of_gain(now.gain_db) * factor
    reasons: list[str] = []
    exposure_s = _limit_exposure(light / _of_gain(limits.gain_db[0]), limits, reasons)
    gain_db = _limit_gain(light / exposure_s, exposure_s, limits, reasons)
    change = exposure_s * _of_gain(gain_db) / (now.exposure_s * _of_gain(now.gain_db))
    peak = None if levels.is_saturated else levels.black + above * change
    if (
        levels.ambient is not None
        and not levels.is_saturated
        and levels.ambient > GOALS.max_ambient_share * levels.peak
    ):
        reasons.append(
            f"light of the room takes {100 * levels.ambient / levels.peak:.0f} % of the range; shade the "
            "scene, or switch the room's lights off"
        )
    is_right = not levels.is_saturated and (
        abs(levels.peak - GOALS.peak) <= GOALS.tolerance or abs(change - 1.0) < 0.01
    )
    return ExposureAdvice(exposure_s, gain_db, peak, tuple(reasons), is_right)


def _of_gain(gain_db: float) -> float:
    return float(10.0 ** (gain_db / 20.0))


def _limit_exposure(wanted_s: float, limits: ExposureLimits, reasons: list[str]) -> float:
    lower_s, upper_s = limits.exposure_s
    shortest_s = max(lower_s, limits.period_s)
    if limits.period_s > 0:
        shortest_s = (
            limits.period_s * math.ceil(lower_s / limits.period_s - GOALS.grid_tolerance) or limits.period_s
        )
        upper_s = limits.period_s * math.floor(upper_s / limits.period_s + GOALS.grid_tolerance)
    if wanted_s * (1.0 + GOALS.grid_tolerance) < shortest_s:
        why = (
            "one period of the projector's bit planes" if limits.period_s > lower_s else "the camera's least"
        )
        reasons.append(
            f"even an exposure of {1e3 * shortest_s:.3g} ms, {why}, is {shortest_s / wanted_s:.2g} times too "
            "bright; dim the lamp, or close the camera's aperture"
        )
        return shortest_s
    return min(limits.on_grid(wanted_s), upper_s)


def _limit_gain(factor: float, exposure_s: float, limits: ExposureLimits, reasons: list[str]) -> float:
    min_db, max_db = limits.gain_db
    gain_db = 20.0 * math.log10(factor)
    if gain_db > max_db:
        reached = GOALS.peak / _of_gain(gain_db - max_db)
        reasons.append(
            f"the lamp is weak: the longest exposure of the {limits.of}, {exposure_s:.3g} s, and the "
            f"greatest gain, {max_db:.3g} dB, reach {100 * reached:.0f} % of full scale; open "
            "the aperture, brighten the lamp, or go nearer"
        )
    return min(max(gain_db, min_db), max_db)
