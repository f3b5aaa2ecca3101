"""Light and sharpness of the twin: Gauss-Newton on image residuals, with slopes by finite differences.

Only products are known: of lamp, board and lens. What is free is chosen so that it is determined: the level
of the board's ground by `white` (or `paper`, where the white is known from a card), then its print, ambient
light, and the camera's black level.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fpplab.core.conventions import Floats, PixelIndices
from fpplab.matching.loss import BEYOND_PX, board_mask, soft_weights, thinned
from fpplab.matching.reference import Reference
from fpplab.patterns.response import Curve
from fpplab.simulation.matchable import Parameters, Twin

PIXELS = 20_000
"""Of a pose that are looked at."""
ROUNDS = 3
SETTLED = 5e-3
"""Relative gain of a round from which it is the last."""
HALVINGS = 4


@dataclass(frozen=True)
class Knob:
    """One number of a twin: how to read and set it, by how much to try it, and what it may be."""

    step: float
    least: float
    most: float
    read: Callable[[Parameters], float]
    set: Callable[[Parameters, float], Parameters]

    def turned(self, parameters: Parameters, value: float) -> Parameters:
        return self.set(parameters, min(max(value, self.least), self.most))


def _plain(name: str, step: float, least: float, most: float) -> Knob:
    def read(parameters: Parameters) -> float:
        return float(getattr(parameters, name))

    def set_(parameters: Parameters, value: float) -> Parameters:
        changes: dict[str, Any] = {name: value}
        return replace(parameters, **changes)

    return Knob(step, least, most, read, set_)


def response_of(g: float, black: float) -> Curve:
    """A response whose white is 1; black: what is shown of a dark picture, b."""
    return Curve(a=1.0 - black, b=black, g=g)


KNOBS = {
    "white": _plain("white", 0.01, 0.01, 100.0),
    "paper": _plain("paper", 0.01, 0.02, 1.0),
    "ink": _plain("ink", 0.005, 0.0, 1.0),
    "ambient": _plain("ambient", 0.005, 0.0, 10.0),
    "black_level": _plain("black_level", 0.002, 0.0, 0.49),
    "projector_blur": _plain("projector_blur", 0.05, 0.35, 20.0),
    "projector_focus_mm": _plain("projector_focus_mm", 2.0, 50.0, 5000.0),
    "projector_aperture_mm": _plain("projector_aperture_mm", 0.5, 0.0, 60.0),
    "camera_focus_mm": _plain("camera_focus_mm", 2.0, 50.0, 5000.0),
    "f_number": _plain("f_number", 0.2, 0.7, 64.0),
    "vignetting": _plain("vignetting", 0.5, 0.0, 40.0),
    "b": Knob(
        0.005,
        0.0,
        0.5,
        lambda p: p.response.b,
        lambda p, v: replace(p, response=response_of(p.response.g, v)),
    ),
    "g": Knob(
        0.01, 0.2, 5.0, lambda p: p.response.g, lambda p, v: replace(p, response=response_of(v, p.response.b))
    ),
}


@dataclass(frozen=True, eq=False)
class Sample:
    """Some pixels of some images of a pose, and the bench's levels (n, P) there."""

    pose: int
    images: tuple[int, ...]
    pixels: PixelIndices
    seen: Floats


def samples(
    bench: Reference, parameters: Parameters, poses: Sequence[int], images: Sequence[int]
) -> list[Sample]:
    """Of the board and its edge in some images of some poses."""

    def one(pose: int) -> Sample:
        area = board_mask(parameters.calibration.camera, parameters.poses[pose], bench.target, -BEYOND_PX)
        pixels = thinned(area, PIXELS)
        seen = bench.frames(pose, images)[:, *pixels].astype(np.float64)
        return Sample(pose, tuple(images), pixels, seen)

    return [one(pose) for pose in poses]


def light_residuals(bench: Reference, twin: Twin, looked: Sequence[Sample]) -> Floats:
    """The bench less the twin as it stands, in raw levels, 0 where either is saturated: (all pixels,)."""
    return np.concatenate([_residual(bench, twin, sample).ravel() for sample in looked])


def _residual(bench: Reference, twin: Twin, sample: Sample) -> Floats:
    patterns = bench.shown(sample.images)
    here = twin.expected_at(sample.pose, patterns, bench.settings, sample.pixels).astype(np.float64)
    clear = (sample.seen < bench.full_scale) & (here < bench.full_scale)
    return np.where(clear, sample.seen - here, 0.0)


def difference(bench: Reference, twin: Twin, looked: Sequence[Sample]) -> float:
    """Mean square of the residuals, in raw levels squared."""
    return float(np.mean(light_residuals(bench, twin, looked) ** 2))


def fit_light(bench: Reference, twin: Twin, names: Sequence[str], looked: Sequence[Sample]) -> Parameters:
    """The twin's parameters with the named knobs turned to where the images differ least, all else held."""
    best = twin.parameters
    left = light_residuals(bench, twin, looked)
    for _ in range(ROUNDS):
        gained, best, left = _round(bench, twin, names, looked, best, left)
        if gained < SETTLED:
            break
    twin.become(best)
    return best


def _round(
    bench: Reference,
    twin: Twin,
    names: Sequence[str],
    looked: Sequence[Sample],
    start: Parameters,
    left: Floats,
) -> tuple[float, Parameters, Floats]:
    """One step: the relative gain, the parameters and what they leave."""
    weight, _ = soft_weights(left)
    cost = float(np.sum(weight * left**2))
    slopes = []
    for name in names:
        knob = KNOBS[name]
        value = knob.read(start)
        by = knob.step if value + knob.step <= knob.most else -knob.step
        twin.become(knob.set(start, value + by))
        slopes.append((left - light_residuals(bench, twin, looked)) / by)
    matrix = np.stack(slopes, axis=1)
    scale = np.sqrt(np.sum(weight[:, None] * matrix**2, axis=0))
    scale[scale == 0] = 1.0
    scaled = matrix / scale
    normal, gradient = scaled.T @ (weight[:, None] * scaled), scaled.T @ (weight * left)
    step = np.linalg.lstsq(normal, gradient, rcond=1e-9)[0] / scale
    for tried, after in _tries(bench, twin, names, looked, start, step):
        gain = 1.0 - float(np.sum(weight * after**2)) / max(cost, 1e-12)
        if gain > 0:
            return gain, tried, after
    return 0.0, start, left


def _tries(
    bench: Reference,
    twin: Twin,
    names: Sequence[str],
    looked: Sequence[Sample],
    start: Parameters,
    step: Floats,
) -> Iterator[tuple[Parameters, Floats]]:
    """The step, and shorter ones."""
    for halving in range(HALVINGS):
        tried = start
        for name, by in zip(names, step.tolist(), strict=True):
            knob = KNOBS[name]
            tried = knob.turned(tried, knob.read(start) + by / 2**halving)
        twin.become(tried)
        yield tried, light_residuals(bench, twin, looked)


def coarse_focus(
    bench: Reference,
    twin: Twin,
    looked: Sequence[Sample],
    focus: str,
    aperture: str,
    apertures: Sequence[float],
) -> Parameters:
    """The best of a grid of focus and aperture, or the twin as it is: where a fit of both can start.

    apertures: relative to the twin's own. The nearest, the middle and the farthest pose tell enough.
    """
    start = twin.parameters
    looked = [looked[0], looked[len(looked) // 2], looked[-1]]
    own = float(getattr(start, aperture))
    depths = np.array([pose.translation[2] for pose in start.poses])
    if focus == "projector_focus_mm":
        to_projector = start.calibration.T_projector_camera
        depths = np.array([to_projector.apply(pose.translation)[2] for pose in start.poses])
    middle, half = float(np.median(depths)), max(float(np.ptp(depths)), 0.05 * float(np.median(depths)))
    grid = [(middle + share * half, own * opening) for share in (-0.4, 0.0, 0.4) for opening in apertures]
    best, least = start, difference(bench, twin, looked)
    for depth, opening in grid:
        changes: dict[str, Any] = {focus: depth, aperture: opening}
        tried = replace(start, **changes)
        twin.become(tried)
        if (found := difference(bench, twin, looked)) < least:
            best, least = tried, found
    twin.become(best)
    return best
