"""Which of two lenses is out of focus, and what a blurred image of the camera costs."""

from __future__ import annotations

import math

import numpy as np

from fpplab.core.conventions import Axis, axis_length
from fpplab.diagnosis.catalogue import FaultCause, Finding
from fpplab.diagnosis.sample import LIT_SHARE, MEDIAN, FrameSample

LEAST_CONTRAST = 0.5
"""Least contrast of the finest fringes, as a share of that of a rig in focus."""

FOCUSED_PX = 0.9
"""Blur of a rig in focus in projector px: half a mirror of the projector's lens, and the camera's share."""

BLURRED_PX = 1.8
"""Blur of the camera's image in px that is out of focus."""

CAMERA_SHARE = 0.45
"""Blur of edges, as a share of that of the fringes, from which on the camera is out of focus."""

EDGE_CONTRAST = 0.25
"""Least range of grey levels in a tile, of the brightest, that is an edge."""

FULL_CONTRAST = 0.6
"""Least range in a tile beside the greatest: blur takes contrast from fine detail, which then looks sharp."""

USELESS_BLUR = 8.0
"""Error that a blurred image gives the phase, beside the noise in focus, from which on points are useless."""


def fringe_blur_px(sample: FrameSample, axis: Axis) -> tuple[float, float] | None:
    """Estimate the blur of the fringes from the modulation of the finest set beside the widest."""
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
    mean = sample.offsets_in_tiles.mean(axis=0)
    brightest = float(np.percentile(sample.widest.offset, 98))
    ranges = np.array([np.ptp(np.percentile(tile, (2, 98))) for tile in mean])
    if len(ranges) < 2:
        return None
    least = max(EDGE_CONTRAST * brightest, FULL_CONTRAST * float(np.sort(ranges)[-2]))
    used = ranges >= least
    if used.sum() < 2:
        return None
    steepest = np.array([np.percentile(np.hypot(*np.gradient(tile)), 99) for tile in mean[used]])
    return float(np.percentile(ranges[used] / steepest, 20)) / math.sqrt(2 * math.pi)


def focus_finding(sample: FrameSample, projector_px_per_px: float | None) -> Finding | None:
    """Tell which lens is out of focus."""
    seen = [
        (found[1] / _sharp_contrast(sample, axis), found, axis)
        for axis in sample.recording.plan.axes
        if (found := fringe_blur_px(sample, axis)) is not None
    ]
    if not seen:
        return None
    # Fringes of another axis may be so wide that they keep their contrast.
    _, (blur, contrast), axis = min(seen)
    sharp = _sharp_contrast(sample, axis)
    edge = edge_blur_px(sample)
    scale = projector_px_per_px or 1.0
    of_camera = edge is not None and scale * edge > CAMERA_SHARE * blur
    soft = of_camera and edge is not None and edge > BLURRED_PX and blur > 0.7 * scale * BLURRED_PX
    if contrast >= LEAST_CONTRAST * sharp and not soft:
        return None
    cause = FaultCause.CAMERA_FOCUS if of_camera else FaultCause.PROJECTOR_FOCUS
    edges = "there are no edges to compare with" if edge is None else f"edges in the image by {edge:.1f} px"
    words = (
        f"the finest fringes have {100 * contrast:.0f} % of the widest ones' contrast ({100 * sharp:.0f} % "
        f"in focus): blurred by {blur:.1f} projector px; {edges}"
    )
    excess = max(LEAST_CONTRAST * sharp / max(contrast, 1e-3), 1.0)
    harm = _harm(sample, edge) * sharp / max(contrast, 1e-3) if of_camera and edge is not None else 0.0
    return Finding(cause, words, excess, ruins_points=harm >= USELESS_BLUR)


def _harm(sample: FrameSample, blur_px: float) -> float:
    """Typical error of the phase of the finest fringes beside its noise, by a blur of the camera's image.

    A blur by σ mixes neighbours whose phase and brightness differ: the phase is off by σ² ∇φ ∇ln A.
    """
    finest = sample.recording.plan.finest_set()
    fit = sample.tile_fits[finest]
    used = fit.modulation >= LIT_SHARE * np.percentile(fit.modulation, 98)
    turn, level = np.exp(1j * fit.phase), np.log(np.maximum(sample.offsets_in_tiles.mean(axis=0), 1.0))
    off = np.zeros(fit.phase.shape)
    for axis in (1, 2):
        change = np.angle(np.roll(turn, -1, axis) * turn.conj())
        off += float(np.median(change[used])) * np.gradient(level, axis=axis)
    return blur_px**2 * float(np.median(np.abs(off[used]))) / MEDIAN / sample.phase_noise(finest)


def _sharp_contrast(sample: FrameSample, axis: Axis) -> float:
    """Contrast of the finest fringes along an axis of a rig in focus."""
    finest, _ = sample.recording.finest(axis)
    frequency = finest.stripes / axis_length(sample.recording.projector_size, axis)
    return math.exp(-2 * (math.pi * FOCUSED_PX * frequency) ** 2)
