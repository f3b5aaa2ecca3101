"""The exposure that uses the camera's range: as long as it may be, and gain only for what is then missing.

The brightest lit pixels are to reach `TARGET` of full scale. What they have above the camera's black level
is proportional to exposure and gain, so one step leads there from anything that is not saturated. What the
devices do not allow is said, never applied in silence: the camera's limits, and the period in which a
projector shows its bit planes, of which an exposure must be a whole number.
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

TARGET = 0.88
"""Share of full scale that the brightest lit pixels are to reach."""

BRIGHTEST = 99.5
"""Percentile of the lit pixels that counts as the brightest: highlights may saturate."""

LEAST_PEAK = 1e-3
"""Share of full scale that the brightest lit pixels are taken to have above black at least."""

CLOSE = 0.03
"""A peak that lies no further from the target is right."""

SATURATED_FACTOR = 0.25
"""Change of light where the peak is saturated and nobody knows by how much."""

AMBIENT_SHARE = 0.5
"""Share of the range from which on light that is not the projector's limits the fringes."""

GRID_TOLERANCE = 0.01
"""By how much of a bit-plane period an exposure may be rounded up."""


@dataclass(frozen=True)
class LightLevels:
    """What the camera has of its range."""

    peak: float  # level of the brightest lit pixels, as a share of full scale
    saturated: float  # share of the lit pixels that are saturated
    ambient: float | None = None  # light that does not change with the fringes, as a share of full scale
    black: float = 0.0  # the camera's level without light, as a share of full scale

    @property
    def is_saturated(self) -> bool:
        """Whether the peak is not known, because too many pixels are saturated."""
        return self.saturated > 1.0 - BRIGHTEST / 100.0


@dataclass(frozen=True)
class ExposureLimits:
    """What the devices allow."""

    exposure_s: tuple[float, float]  # least and greatest exposure, in s
    gain_db: tuple[float, float]  # least and greatest gain, in dB
    period_s: float = 0.0  # exposures are whole multiples of this, in s; 0 where any will do
    of: str = "camera"  # who limits the longest exposure, for messages

    @classmethod
    def by_devices(cls, camera: CameraCaps, projector: ProjectorCaps, plan: Plan) -> ExposureLimits:
        """Find what a plan may be exposed with on a rig."""
        least, most = camera.exposure_s
        if plan.trigger == "stepped":
            return cls((least, most), camera.gain_db, projector.period_s)
        shown_s = projector.bit_depths[max(projector.bit_depths)], projector.longest_s
        least, longest = max(least, shown_s[0] - camera.readout_s), shown_s[1] - camera.readout_s
        return cls(
            (least, min(most, longest)), camera.gain_db, 0.0, "camera" if most <= longest else "projector"
        )

    def on_grid(self, exposure_s: float) -> float:
        """Round an exposure down to whole bit-plane periods, of which there is one at least."""
        if self.period_s <= 0:
            return exposure_s
        return self.period_s * max(1, math.floor(exposure_s / self.period_s + GRID_TOLERANCE))

    def stepped(self, exposure_s: float, factor: float) -> float:
        """Give the next exposure that is longer or shorter."""
        wanted = exposure_s * factor
        if self.period_s <= 0:
            return wanted
        steps = max(1, round(wanted / self.period_s))
        now = exposure_s / self.period_s
        if factor > 1.0:
            return self.period_s * max(steps, math.floor(now + GRID_TOLERANCE) + 1)
        return self.period_s * max(0, min(steps, math.ceil(now - GRID_TOLERANCE) - 1))


@dataclass(frozen=True)
class ExposureAdvice:
    """An exposure to take."""

    exposure_s: float  # in s
    gain_db: float  # in dB
    peak: float | None  # level that the brightest lit pixels will reach, as a share of full scale
    limits: tuple[str, ...]  # what keeps the image from being better, and what to do about it
    is_right: bool  # whether the present exposure needs no change

    def summary(self) -> dict[str, object]:
        """Collect what is shown."""
        return {
            "exposure_s": self.exposure_s,
            "gain_db": self.gain_db,
            "peak": self.peak,
            "limits": list(self.limits),
            "is_right": self.is_right,
        }


def levels_of_fringes(sample: FrameSample, black: float = 0.0) -> LightLevels | None:
    """Measure the light of a cycle of fringes."""
    if not sample.lit.any():
        return None
    peaks, widest = sample.spread.max(axis=0)[sample.lit] / 255.0, sample.widest
    other = float(np.median((widest.offset - widest.modulation)[sample.lit])) / 255.0
    saturated = float(sample.saturated[sample.lit].mean())
    return LightLevels(float(np.percentile(peaks, BRIGHTEST)), saturated, max(other - black, 0.0), black)


def levels_of_image(image: Image, bits: int, black: float = 0.0) -> LightLevels:
    """Measure the light of one image of a bright pattern."""
    # image (height, width)
    levels: NDArray[np.floating[Any]] = image[::2, ::2].astype(np.float32) / full_scale(bits)
    least = SampleLimits().min_lit_share
    lit = levels[levels >= least * np.percentile(levels, 99.9)]
    return LightLevels(float(np.percentile(lit, BRIGHTEST)), float((lit >= 1.0).mean()), None, black)


def advise_exposure(levels: LightLevels, now: CameraSettings, limits: ExposureLimits) -> ExposureAdvice:
    """Propose exposure and gain."""
    above = max(levels.peak - levels.black, LEAST_PEAK)
    factor = SATURATED_FACTOR if levels.is_saturated else (TARGET - levels.black) / above
    light = now.exposure_s * _of_gain(now.gain_db) * factor
    words: list[str] = []
    exposure_s = _exposure(light / _of_gain(limits.gain_db[0]), limits, words)
    gain_db = _gain(light / exposure_s, exposure_s, limits, words)
    change = exposure_s * _of_gain(gain_db) / (now.exposure_s * _of_gain(now.gain_db))
    peak = None if levels.is_saturated else levels.black + above * change
    if (
        levels.ambient is not None
        and not levels.is_saturated
        and levels.ambient > AMBIENT_SHARE * levels.peak
    ):
        words.append(
            f"light of the room takes {100 * levels.ambient / levels.peak:.0f} % of the range; shade the "
            "scene, or switch the room's lights off"
        )
    right = not levels.is_saturated and (abs(levels.peak - TARGET) <= CLOSE or abs(change - 1.0) < 0.01)
    return ExposureAdvice(exposure_s, gain_db, peak, tuple(words), right)


def _of_gain(gain_db: float) -> float:
    return float(10.0 ** (gain_db / 20.0))


def _exposure(wanted_s: float, limits: ExposureLimits, words: list[str]) -> float:
    """The longest exposure that is allowed and not too long; says what it could not do."""
    least, most = limits.exposure_s
    shortest = max(least, limits.period_s)
    if limits.period_s > 0:
        shortest = limits.period_s * math.ceil(least / limits.period_s - GRID_TOLERANCE) or limits.period_s
        most = limits.period_s * math.floor(most / limits.period_s + GRID_TOLERANCE)
    if wanted_s * (1.0 + GRID_TOLERANCE) < shortest:
        why = "one period of the projector's bit planes" if limits.period_s > least else "the camera's least"
        words.append(
            f"even an exposure of {1e3 * shortest:.3g} ms, {why}, is {shortest / wanted_s:.2g} times too "
            "bright; dim the lamp, or close the camera's aperture"
        )
        return shortest
    return min(limits.on_grid(wanted_s), most)


def _gain(factor: float, exposure_s: float, limits: ExposureLimits, words: list[str]) -> float:
    """The gain for what the exposure leaves; says where that is not enough."""
    least, most = limits.gain_db
    wanted = 20.0 * math.log10(factor)
    if wanted > most:
        short = wanted - most
        words.append(
            f"the lamp is weak: the longest exposure of the {limits.of}, {exposure_s:.3g} s, and the "
            f"greatest gain, {most:.3g} dB, reach {100 * TARGET / _of_gain(short):.0f} % of full scale; open "
            "the aperture, brighten the lamp, or go nearer"
        )
    return min(max(wanted, least), most)
