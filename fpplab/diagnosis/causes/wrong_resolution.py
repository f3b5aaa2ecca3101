"""The image is scaled before it is projected, or the projector has a different lattice."""

from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.config import Positive
from fpplab.core.conventions import TWO_PI, Axis, Floats, Image, Lattice, Map, Mask, axis_length
from fpplab.core.drawing import ACCENT, ALARM
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.fringe_shape import FringeShapeLimits
from fpplab.diagnosis.limits import CountLimit, LimitsSection, ShareLimit
from fpplab.diagnosis.pictures import curve_axes
from fpplab.diagnosis.sample import FrameSample

ASPECTS = {Lattice.SQUARE: 1.0, Lattice.DIAMOND: 2.0}
"""Distance of columns as a multiple of that of rows, by lattice."""


class WrongResolutionLimits(LimitsSection):
    """What an error of the coordinate may be that repeats with the projector's pixels."""

    max_moire_px: Positive = 0.04
    """Amplitude in projector px. Measured: real rigs reach 0.04 px, pictures that are scaled 0.1 px."""
    min_cycles: Positive = 0.06
    """Least frequency of a moiré in cycles per projector px. Chosen."""
    max_cycles: Positive = 0.55
    """Greatest frequency in cycles per projector px. Derived: that of pixels doubled, 0.5."""
    max_cycles_per_pixel: ShareLimit = 0.8
    """The same in cycles per camera pixel. Derived: what is sampled once in a pixel repeats with it."""
    min_distance_cycles: Positive = 0.006
    """Distance from frequencies of fringes and harmonics, in cycles per px. Measured on benches."""
    fringe_harmonics: CountLimit = 6
    """Harmonics of the fringes that are taken out of the coordinate's roughness. Measured on benches."""
    max_even_change: Positive = 0.03
    """Change of brightness from pixel to pixel, as a share, of an even scene. Measured on benches."""
    min_fringes: Positive = 4.0
    """Periods of a set that have to be seen for its harmonics to be distinguished from a moiré. Chosen."""
    max_stretch: Positive = 0.05
    """Share by which a projector's picture may be stretched. Chosen: lenses differ by less."""
    max_aspect_severity: Positive = 1.5
    """Excess of a stretched picture at most: points are right if the calibration was made with it. Chosen."""


def _find_moire(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    """Errors of the coordinate that repeat along the projector's pixels, but not with the fringes."""
    # A picture that is scaled before it is shown has places where it is off by up to half a pixel.
    spectrum = _strongest_moire(evidence.frames)
    limit = evidence.limits.of(WrongResolutionLimits).max_moire_px
    if spectrum is None:
        return
    cycles, amplitudes = spectrum
    k = int(amplitudes.argmax())
    if amplitudes[k] > limit:
        text = (
            f"the coordinate is off by {amplitudes[k]:.2f} px once in {1.0 / cycles[k]:.1f} projector px (at "
            f"most {limit:g} px): the picture is scaled before it is shown"
        )
        yield Finding(WRONG_RESOLUTION, text, float(amplitudes[k]) / limit)


def _find_other_lattice(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    """A projector whose focal lengths do not belong to the lattice of mirrors that is stated."""
    projector, limits = evidence.points.calibration.projector, evidence.limits.of(WrongResolutionLimits)
    aspect, nominal = float(projector.matrix[1, 1] / projector.matrix[0, 0]), ASPECTS[projector.lattice]
    stretch = abs(aspect / nominal - 1.0)
    if stretch > limits.max_stretch:
        text = (
            f"by the calibration a column of the projector's picture is {aspect:.2f} times as wide as a row "
            f"is high, but {nominal:g} times with the lattice '{projector.lattice.value}' (at most "
            f"{100 * limits.max_stretch:g} % off)"
        )
        yield Finding(WRONG_RESOLUTION, text, min(stretch / limits.max_stretch, limits.max_aspect_severity))


def _strongest_moire(sample: FrameSample) -> tuple[Floats, Floats] | None:
    spectra = [
        spectrum for axis in sample.coordinates if (spectrum := moire_spectrum(sample, axis)) is not None
    ]
    return max(spectra, key=lambda spectrum: float(spectrum[1].max())) if spectra else None


def moire_spectrum(sample: FrameSample, axis: Axis) -> tuple[Floats, Floats] | None:
    """Measure what of the coordinate's roughness repeats with a frequency along the projector's pixels."""
    # returns cycles (F,), amplitudes (F,)
    limits = sample.limits.of(WrongResolutionLimits)
    position, rough = _roughness(sample, sample.coordinates[axis])
    if len(position) < sample.limits.of(FringeShapeLimits).min_pixels:
        return None
    span = float(np.ptp(np.percentile(position, (1, 99))))
    max_cycles = min(limits.max_cycles, limits.max_cycles_per_pixel / _pixel_pitch(sample, axis))
    bins = np.rint(4.0 * (position - position.min())).astype(np.intp)
    count = np.bincount(bins)
    length = max(round(8.0 * max(span, 100.0)), len(count))
    cycles = np.fft.rfftfreq(length, 0.25)
    used = (cycles >= limits.min_cycles) & (cycles < max_cycles)
    size = axis_length(sample.recording.projector_size, axis)
    sets = [fringe.stripes / size for fringe in sample.recording.plan.fringes if fringe.axis == axis]
    fine = [own for own in sets if own >= 0.02]
    for own in fine:
        used &= np.abs(cycles / own - np.rint(cycles / own)) * own > limits.min_distance_cycles
    if not used.any():
        return None
    total = np.asarray(np.bincount(bins, rough), np.float64)
    places = np.arange(len(total)) / 4.0
    # Harmonics of the fringes leak into other frequencies where the span is short.
    total = total - count * _fitted_sinusoids(
        places, total, count, _fringe_harmonics(sets, fine, span, limits)
    )
    sums = np.fft.rfft(total, length)[used]
    return cycles[used], np.asarray(2.0 * np.abs(sums) / count.sum())


def _pixel_pitch(sample: FrameSample, axis: Axis) -> float:
    """Typical change of the coordinate from one camera pixel to the next, in px."""
    coordinate, step = sample.coordinates[axis], sample.step
    here = coordinate[:-1:step, :-1:step]
    changes = coordinate[:-1:step, 1::step] - here, coordinate[1::step, :-1:step] - here
    return float(max(np.nanmedian(np.abs(c)) if np.isfinite(c).any() else 0.0 for c in changes)) or 1.0


def _fringe_harmonics(
    sets: list[float], fine: list[float], span: float, limits: WrongResolutionLimits
) -> list[float]:
    """Cycles per px of harmonics that a fit distinguishes from a moiré."""
    # All those of coarse fringes lie among its frequencies, too close together to be left out.
    cycles = [m * own for own in fine for m in range(1, limits.fringe_harmonics + 1)]
    if not fine and (finest := max(sets)) * span >= limits.min_fringes:
        cycles = [m * finest for m in range(1, int(limits.max_cycles / finest) + 1)]
    return [frequency for frequency in cycles if frequency < limits.max_cycles]


def _fitted_sinusoids(
    positions_px: Floats, sums: Floats, counts: NDArray[np.intp], cycles_per_px: list[float]
) -> Floats:
    """Fit sinusoids and a constant to the bins' means, weighted by counts; return the fit's values (N,)."""
    if not cycles_per_px:
        return np.zeros(len(positions_px))
    angles = TWO_PI * np.outer(positions_px, cycles_per_px)
    waves = np.concatenate([np.cos(angles), np.sin(angles), np.ones((len(positions_px), 1))], axis=1)
    weights = np.sqrt(counts)
    means = sums / np.maximum(counts, 1)
    best = np.linalg.lstsq(weights[:, None] * waves, weights * means, rcond=1e-6)[0]
    return np.asarray(waves @ best)


def _roughness(sample: FrameSample, coordinate: Map) -> tuple[Floats, Floats]:
    """Coordinates of some pixels in a direction in which they change, and how far they are off a line there.

    A blurred edge shifts the coordinate, and so would a regular print; only pixels of an even scene are used.
    """
    step, image = sample.step, sample.recording.mean_image()
    right, down = (np.abs(np.diff(coordinate[::step, ::step], axis=k)) for k in (1, 0))
    steep = np.nanmedian(right) if np.isfinite(right).any() else 0.0
    turned = steep < (np.nanmedian(down) if np.isfinite(down).any() else 0.0)
    along, image = (coordinate.T, image.T) if turned else (coordinate, image)
    every = max(1, along.size // 60_000)  # of which 60 000 coordinates are left at most
    rows = along[::every].astype(np.float64)
    max_change = sample.limits.of(WrongResolutionLimits).max_even_change
    smooth = np.stack([_are_evenly_bright(image, v, max_change) for v in range(0, len(image), every)])
    half = 12  # camera px to each side over which a surface is taken as straight (chosen)
    if rows.shape[1] <= 4 * half:
        return np.empty(0), np.empty(0)
    sums = np.cumsum(np.pad(np.nan_to_num(rows), ((0, 0), (1, 0))), axis=1)
    counts = np.cumsum(np.pad(np.isfinite(rows).astype(np.float64), ((0, 0), (1, 0))), axis=1)
    window = 2 * half + 1
    mean = (sums[:, window:] - sums[:, :-window]) / window
    whole = counts[:, window:] - counts[:, :-window] == window
    middle = rows[:, half : half + mean.shape[1]]
    rough = middle - mean
    whole &= (np.abs(rough) < 1.0) & smooth[:, half : half + mean.shape[1]]
    return middle[whole], rough[whole]


def _are_evenly_bright(image: Image, row: int, max_change: float) -> Mask:
    """Which pixels of a row have neighbours of nearly their own brightness."""
    first = max(row - 4, 0)  # both filters together reach as far
    around = np.ascontiguousarray(image[first : row + 5])
    level = cv2.GaussianBlur(around, (0, 0), 1.0).astype(np.float32)
    change = np.hypot(cv2.Sobel(level, -1, 1, 0, scale=0.125), cv2.Sobel(level, -1, 0, 1, scale=0.125))
    return np.asarray((change < max_change * level)[row - first])


def _draw(evidence: Evidence, _: Finding) -> Figure | None:
    spectrum = _strongest_moire(evidence.frames)
    if spectrum is None:
        return None
    limit = evidence.limits.of(WrongResolutionLimits).max_moire_px
    figure, axes = curve_axes()
    axes.plot(*spectrum, color=ACCENT, linewidth=1.0)
    axes.axhline(limit, color=ALARM, linewidth=1.2, label=f"limit {limit:g} px")
    axes.set(xlabel="cycles per projector px", ylabel="error of the coordinate\nin projector px")
    axes.legend(loc="best")
    return figure


WRONG_RESOLUTION = FaultCause(
    key="wrong_resolution",
    meaning="The image is scaled before it is projected, or the projector has a different lattice.",
    remedy="set the display to the projector's native resolution, without scaling, keystone or "
    "overscan, and state the correct lattice of the projector",
    measured="periodic error of the coordinate along projector pixels that does not follow the "
    "fringes; ratio of focal lengths in the calibration relative to that of the lattice",
    limit=f"{WrongResolutionLimits().max_moire_px:g} px; {100 * WrongResolutionLimits().max_stretch:g} %",
    seen_in="coordinates, points",
    detectors=(
        Detector(DetectionStage.FRAMES, _find_moire),
        Detector(DetectionStage.POINTS, _find_other_lattice),
    ),
    picture=Picture(Needs.FRAMES, _draw),
    side_effects=frozenset({"stale_calibration"}),
    useless_if_first_from=1.6,  # 0.064 px: on benches frames without scaling reach 0.06 px
)
