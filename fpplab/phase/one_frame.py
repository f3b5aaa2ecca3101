"""One frame of fringes: a sinusoid is fitted to the neighbourhood of every pixel (Fourier profilometry).

The frame's spectrum tells the carrier. Offset, cosine and sine of a fringe are fitted by least squares under
a Gaussian window, first to the carrier and then to the phase that this gives, so that a fringe that is wider
or narrower than the carrier is followed. Since the offset is fitted too and pixels beyond the image or
saturated have no weight, nothing leaks from edges; where a window is cut all the same, its pixel is not
measured. What the fit leaves tells the noise, and where it leaves more than elsewhere the window holds a
step, an edge of brightness or a shadow, of which the phase says nothing.

One frame does not tell in which direction the phase rises: it is taken to rise along the camera's axis.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from fpplab.core.conventions import TWO_PI, Axis, Floats, Map, Mask, axis_length
from fpplab.core.errors import DataError
from fpplab.core.progress import Progress
from fpplab.patterns.fringe_sets import PeriodicSet
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.patterns.unwrapping import unwrapping_methods
from fpplab.phase.bounds import DecodingBounds, PossibleCoordinates
from fpplab.phase.decoded import Decoded
from fpplab.phase.error_model import saturation_of
from fpplab.phase.islands import find_islands
from fpplab.phase.limits import NOISE, ONE_FRAME
from fpplab.phase.noise import QUANTISATION, fit_line, level_step
from fpplab.phase.spatial_axis import UnwrappedIslands, placed

_BANDWIDTH = 4.0 - 8.0 / 3.0 + 0.5
"""Variance of the second fit beside that of the first one. Derived: its filter is 2G - G² where that of the
first is a Gaussian G, and the integral of its square is 11/6 of that of G²."""


def single_frame(plan: Plan) -> PeriodicSet | None:
    """Give the set of a plan that has one image alone, which neighbours unwrap; None for other plans."""
    only, is_spatial = plan.sets[0], unwrapping_methods()[plan.unwrapping].spatial
    return only if isinstance(only, PeriodicSet) and plan.images == 1 and is_spatial else None


@dataclass(frozen=True, eq=False)
class _Fit:
    """A sinusoid fitted around every pixel, (height, width)."""

    cosine: Floats  # in phase with the reference, grey levels
    sine: Floats
    offset: Floats  # grey levels
    rest: Floats  # mean square of what is left, in grey levels squared

    @property
    def modulation(self) -> Floats:
        return np.hypot(self.cosine, self.sine)

    @property
    def phase(self) -> Floats:
        """Beyond the reference, in rad."""
        return np.arctan2(-self.sine, self.cosine)


def decode_single_frame(recording: Recording, bounds: DecodingBounds, progress: Progress) -> Decoded:
    """Find the projector coordinates of islands of one frame."""
    shown, rules, grey = single_frame(recording.plan), recording.plan.masks, recording.grey
    assert shown is not None
    level = recording.light(recording.frames[0] * grey).astype(np.float64)
    usable = recording.frames[0] < saturation_of(recording)
    carrier = _carrier(level, shown.axis, recording.name)
    window_px = ONE_FRAME.window_periods / math.hypot(*carrier)
    v, u = np.indices(level.shape)
    fringe = TWO_PI * (carrier[0] * u + carrier[1] * v)
    fringe = fringe + _fitted(level, usable, fringe, window_px).phase
    progress(0.5)
    fit = _fitted(level, usable, fringe, window_px)
    modulation, phase = fit.modulation, (fringe + fit.phase + float(shown.phase_shifts()[0])) % TWO_PI
    progress(0.9)
    valid = _is_whole(usable, window_px) & (np.sqrt(fit.rest) <= rules.residual_max * modulation)
    valid &= (modulation >= rules.modulation_min) & (modulation >= rules.contrast_min * fit.offset)
    expected = _noise_by_level(fit, valid, level_step(recording.frames[0]) * grey)
    valid &= fit.rest <= ONE_FRAME.max_rest_ratio * expected
    noise = np.sqrt(2.0 * np.maximum(fit.rest, QUANTISATION * grey**2)) / np.maximum(modulation, 1e-30)
    sigma_rad = noise * math.sqrt(_BANDWIDTH / (4.0 * np.pi)) / window_px
    period_px = axis_length(recording.projector_size, shown.axis) / shown.stripes
    possible = bounds.get(shown.axis)
    possible = possible if isinstance(possible, PossibleCoordinates) else None
    unplaced = find_islands(phase, sigma_rad, valid, window_px)
    islands = placed(unplaced, recording, shown.axis, period_px, sigma_rad, possible)
    valid &= islands.island != 0
    maps = islands.coordinate, modulation, sigma_rad * period_px / TWO_PI, np.sqrt(fit.rest / expected)
    return _decoded(
        [np.where(valid, m, np.nan).astype(np.float32) for m in maps], shown.axis, islands, window_px
    )


def _decoded(maps: Sequence[Map], axis: Axis, islands: UnwrappedIslands, window_px: float) -> Decoded:
    coordinate, modulation, sigma, misfit = maps
    empty = np.broadcast_to(np.float32(np.nan), sigma.shape)
    u, v = (coordinate, empty) if axis == "x" else (empty, coordinate)
    return Decoded(
        u,
        v,
        modulation,
        sigma,
        disagreement=misfit,
        island=np.where(np.isfinite(sigma), islands.island, np.int32(0)),
        resolution_px=2.0 * window_px,
    )


def _noise_by_level(fit: _Fit, valid: Mask, step: float) -> Floats:
    """Variance of the grey levels where a window holds one surface, by their level."""
    floor = QUANTISATION * step**2
    if np.count_nonzero(valid) < NOISE.min_pixels:
        return np.full(valid.shape, floor)
    thin = max(1, np.count_nonzero(valid) // NOISE.sample_pixels)
    level, rest = (values[valid][::thin] for values in (fit.offset, fit.rest))
    return fit_line(level, rest, ONE_FRAME.rest_freedom, step).variance(np.maximum(fit.offset, 0.0))


def _carrier(level: Floats, axis: Axis, name: str) -> tuple[float, float]:
    """Find the strongest wave of a frame, in periods per px along columns and rows."""
    height, width = level.shape
    window = np.outer(np.hanning(height), np.hanning(width))
    power = np.abs(np.fft.rfft2((level - level.mean()) * window)) ** 2
    down, across = np.meshgrid(np.fft.fftfreq(height), np.fft.rfftfreq(width), indexing="ij")
    periods = np.hypot(down * height, across * width)
    frequency = np.hypot(down, across)
    allowed = (periods >= ONE_FRAME.min_periods) & (frequency <= 1.0 / ONE_FRAME.min_period_px)
    if not allowed.any():
        raise DataError(f"{name}: is {width} x {height} px, too small for the fringes of one frame")
    # The offset of the scene falls with the frequency, which a wave of fringes stands out of.
    stands_out = np.where(allowed, power * frequency**2, 0.0)
    at = np.unravel_index(int(np.argmax(stands_out)), power.shape)
    near = allowed & (np.abs(frequency / frequency[at] - 1.0) < 0.5)
    if power[at] < ONE_FRAME.min_peak_ratio * float(np.median(power[near])):
        raise DataError(
            f"{name}: no fringes of at least {ONE_FRAME.min_periods:g} periods stand out of the frame; one "
            "frame needs fine fringes of one direction"
        )
    fu, fv = float(across[at]), float(down[at])
    rising = fu if axis == "x" else fv
    return (fu, fv) if rising >= 0 else (-fu, -fv)


def _fitted(level: Floats, usable: Mask, reference: Floats, window_px: float) -> _Fit:
    """Fit offset, cosine and sine of a reference phase under a window about every pixel."""
    weight = usable.astype(np.float64)
    cosine, sine = np.cos(reference), np.sin(reference)
    waves = np.stack([np.ones_like(level), cosine, sine])
    blurred = {
        (i, j): _blurred(weight * waves[i] * waves[j], window_px) for i in range(3) for j in range(i, 3)
    }
    normal = np.stack([np.stack([blurred[min(i, j), max(i, j)] for j in range(3)], -1) for i in range(3)], -2)
    right = np.stack([_blurred(weight * level * wave, window_px) for wave in waves], -1)
    normal += ONE_FRAME.ridge * np.eye(3)
    fitted = np.linalg.solve(normal, right[..., None])[..., 0]
    left = _blurred(weight * level**2, window_px) - np.sum(fitted * right, axis=-1)
    total = np.maximum(blurred[0, 0], ONE_FRAME.ridge)
    offset, along, across = np.moveaxis(fitted, -1, 0)
    return _Fit(along, across, offset, np.maximum(left, 0.0) / total)


def _blurred(values: Floats, window_px: float) -> Floats:
    side = 2 * math.ceil(ONE_FRAME.window_reach * window_px) + 1
    border = cv2.BORDER_CONSTANT
    return np.asarray(cv2.GaussianBlur(values, (side, side), window_px, borderType=border), np.float64)


def _is_whole(usable: Mask, window_px: float) -> Mask:
    """Where nearly all of a window lies on usable pixels."""
    return _blurred(usable.astype(np.float64), window_px) >= ONE_FRAME.min_window_share
