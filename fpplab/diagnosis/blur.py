"""How blurred fringes and edges are, by which two lenses out of focus are distinguished."""

import math
from dataclasses import dataclass

import numpy as np

from fpplab.core.config import Positive
from fpplab.core.conventions import Axis, axis_length
from fpplab.diagnosis.limits import LimitsSection
from fpplab.diagnosis.sample import MEDIAN, FrameSample, SampleLimits


class BlurLimits(LimitsSection):
    """From when on a lens is out of focus, and which."""

    min_contrast: Positive = 0.5
    """Contrast of the finest fringes, as a share of that of a rig in focus. Chosen: noise is then doubled."""
    focused_px: Positive = 0.9
    """Blur of a rig in focus in projector px. Derived: half a mirror of its lens, and the camera's share."""
    max_camera_px: Positive = 1.8
    """Blur of the camera's image in px. Measured on benches."""
    min_camera_share: Positive = 0.45
    """Blur of edges, as a share of the fringes', above which the camera is blurred. Measured on benches."""
    min_edge_contrast: Positive = 0.25
    """Range of grey levels in a tile with an edge, as a share of the brightest. Chosen."""
    min_full_contrast: Positive = 0.6
    """The same as a share of the greatest range: blur takes contrast from fine detail, which then looks
    sharp. Measured on benches."""
    useless_phase_error: Positive = 8.0
    """Error that a blurred image gives the phase, as a multiple of the noise in focus, above which points
    are useless. Measured: on eight benches the true error was one to two and a half times the estimate."""


@dataclass(frozen=True)
class Blur:
    """Blur of fringes along the axis that loses most contrast, and of edges."""

    contrast: float  # of the finest fringes relative to the widest
    sharp_contrast: float  # the same of a rig in focus
    fringes_px: float  # blur in projector px
    edges_px: float | None  # blur in camera px; None where the image has no edges
    is_camera: bool  # whether the camera is the lens that is more out of focus
    is_soft: bool  # whether the camera's image is soft, whatever the contrast
    limits: BlurLimits

    @property
    def is_out_of_focus(self) -> bool:
        return self.contrast < self.limits.min_contrast * self.sharp_contrast or self.is_soft

    @property
    def evidence(self) -> str:
        edges = "there are no edges to compare with"
        if self.edges_px is not None:
            edges = f"edges in the image by {self.edges_px:.1f} px"
        return (
            f"the finest fringes have {100 * self.contrast:.0f} % of the widest ones' contrast "
            f"({100 * self.sharp_contrast:.0f} % in focus): blurred by {self.fringes_px:.1f} projector px; "
            f"{edges}"
        )

    @property
    def excess(self) -> float:
        """How far the contrast is below its limit."""
        return max(self.limits.min_contrast * self.sharp_contrast / max(self.contrast, 1e-3), 1.0)


def measured_blur(sample: FrameSample, projector_px_per_px: float | None) -> Blur | None:
    """Measure the blur of fringes and edges; None where the fringe sets do not determine it."""
    limits = sample.limits.of(BlurLimits)
    measured = []
    for axis in sample.recording.plan.axes:
        if (blur := fringe_blur_px(sample, axis)) is not None:
            sharp = _sharp_contrast(sample, axis, limits)
            measured.append((blur[1] / sharp, *blur, sharp))
    if not measured:
        return None
    # Fringes of another axis may be so wide that they keep their contrast.
    _, blur_px, contrast, sharp = min(measured)
    edge_px = edge_blur_px(sample)
    scale = projector_px_per_px or 1.0
    is_camera = edge_px is not None and scale * edge_px > limits.min_camera_share * blur_px
    is_soft = (
        is_camera
        and edge_px is not None
        and edge_px > limits.max_camera_px
        and blur_px > 0.7 * scale * limits.max_camera_px
    )
    return Blur(contrast, sharp, blur_px, edge_px, is_camera, is_soft, limits)


def fringe_blur_px(sample: FrameSample, axis: Axis) -> tuple[float, float] | None:
    """Estimate the blur of the fringes from the modulation of the finest set relative to the widest."""
    plan, size = sample.recording.plan, axis_length(sample.recording.projector_size, axis)
    sets = [k for k, fringe in enumerate(plan.fringes) if fringe.axis == axis]
    frequency = {k: plan.fringes[k].stripes / size for k in sets}
    if len(sets) < 2 or not sample.measured.any():
        return None
    wide, fine = min(sets, key=frequency.__getitem__), max(sets, key=frequency.__getitem__)
    if frequency[fine] < 1.5 * frequency[wide]:
        return None
    strong, weak = (sample.fits[k].modulation[sample.measured] for k in (wide, fine))
    ratios = weak / np.maximum(strong, 1e-9)
    contrast = float(np.median(ratios))
    square = -math.log(min(max(contrast, 1e-3), 1.0)) / (2 * math.pi**2)
    return math.sqrt(square / (frequency[fine] ** 2 - frequency[wide] ** 2)), contrast


def edge_blur_px(sample: FrameSample) -> float | None:
    """Estimate the blur of the camera's image from its sharpest strong edges."""
    limits = sample.limits.of(BlurLimits)
    mean = sample.offsets_in_tiles.mean(axis=0)
    brightest = float(np.percentile(sample.widest.offset, 98))
    ranges = np.array([np.ptp(np.percentile(tile, (2, 98))) for tile in mean])
    if len(ranges) < 2:
        return None
    lowest = max(limits.min_edge_contrast * brightest, limits.min_full_contrast * float(np.sort(ranges)[-2]))
    used = ranges >= lowest
    if used.sum() < 2:
        return None
    steepest = np.array([np.percentile(np.hypot(*np.gradient(tile)), 99) for tile in mean[used]])
    return float(np.percentile(ranges[used] / steepest, 20)) / math.sqrt(2 * math.pi)


def phase_error_of_blur(sample: FrameSample, blur_px: float) -> float:
    """Typical phase error of the finest fringes relative to its noise, by a blur of the camera's image."""
    # A blur by σ mixes neighbours whose phase and brightness differ: the phase is off by σ² ∇φ ∇ln A.
    finest = sample.recording.plan.finest_set()
    fit = sample.tile_fits[finest]
    lit_share = sample.limits.of(SampleLimits).min_lit_share
    used = fit.modulation >= lit_share * np.percentile(fit.modulation, 98)
    turn, level = np.exp(1j * fit.phase), np.log(np.maximum(sample.offsets_in_tiles.mean(axis=0), 1.0))
    phase_error = np.zeros(fit.phase.shape)
    for axis in (1, 2):
        change = np.angle(np.roll(turn, -1, axis) * turn.conj())
        phase_error += float(np.median(change[used])) * np.gradient(level, axis=axis)
    return blur_px**2 * float(np.median(np.abs(phase_error[used]))) / MEDIAN / sample.phase_noise(finest)


def _sharp_contrast(sample: FrameSample, axis: Axis, limits: BlurLimits) -> float:
    """Contrast of the finest fringes along an axis of a rig in focus."""
    finest, _ = sample.recording.finest(axis)
    frequency = finest.stripes / axis_length(sample.recording.projector_size, axis)
    return math.exp(-2 * (math.pi * limits.focused_px * frequency) ** 2)
