"""Whether a part moved while it was scanned, from what the phase fit leaves of the frames.

A part that warms, or is not clamped, moves a little further from frame to frame. Frame n of a fringe set is

    A + B cos(δ_n - ψ - κ v (n - (N-1)/2)),    κ = dψ/ds

with the speed v along the camera's axis, and the change κ of the phase for a displacement s of the surface,
which follows from the calibration and the surface's normal. Motion within the surface shows nowhere. To first
order in v the fringe changes by a pattern that offset and fringe of a pixel do not hide, so that least
squares over thousands of pixels find v and the factor of each frame's light. Vibration gives such a speed
by chance; how large, follows from the displacements of the twin.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import TWO_PI, Axis, Floats, PixelIndices, axis_length, full_scale
from fpplab.core.robust import huber_weights, multiway_covariance, robust_spread
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.phase.common_errors import beyond_fringe, fit_sinusoids, fringe_levels
from sim.matching.loss import subsample_pixels
from sim.matching.samples import tile_numbers
from sim.matching.scene.artefacts import CLIPPED, BenchScan, lit_inside, part_surface_seen
from sim.parameters import TwinParameters
from sim.twin import Twin


@dataclass(frozen=True)
class MotionLimits:
    """How the motion of a part in its scan is found."""

    pixels: int = 6_000  # of a scan that are used, about (chosen, for speed)
    min_pixels: int = 200  # that determine a motion (chosen)
    step_mm: float = 0.01  # displacement for the derivative of phases (numerical)
    min_sigmas: float = 4.0  # that a speed must exceed (chosen)
    min_um_per_frame: float = 0.5  # that a speed must exceed (chosen)
    rounds: int = 4  # robust fits (chosen)


LIMITS = MotionLimits()


@dataclass(frozen=True)
class ScanMotion:
    """Speed of a part along the camera's axis."""

    um_per_frame: float  # away from the camera, in µm from frame to frame
    sigma: float  # standard uncertainty, by what the fit leaves and by vibration

    @property
    def is_significant(self) -> bool:
        """Whether neither noise nor vibration explains the speed."""
        return abs(self.um_per_frame) > max(LIMITS.min_sigmas * self.sigma, LIMITS.min_um_per_frame)


def motion_of_scan(twin: Twin, scan: BenchScan) -> ScanMotion | None:
    """Estimate how fast a part moved."""
    inner = lit_inside(twin, scan)
    plan = scan.session.plan
    sets = [index for index in plan.fringe_indices if plan.sets[index].images > 3]
    if not sets or np.count_nonzero(inner) < LIMITS.min_pixels:
        return None
    pixels = subsample_pixels(inner, LIMITS.pixels)
    turns = {axis: _turns(twin, scan, pixels, axis) for axis in scan.session.plan.axes}
    motions = [_SetMotion.of(twin, scan, pixels, index, turns) for index in sets]
    parts = [motion for motion in motions if motion is not None]
    return _fit_common_speed(parts, twin.parameters) if parts else None


@dataclass(frozen=True, eq=False)
class _SetMotion:
    """One fringe set: what is left of its images, and what a unit speed and single displacements make of it.

    rest: (N, P), of speed and gains alone; speed (N, P) for 1 mm a frame; shown (N, N, P): by a displacement
    of 1 mm in one of the frames; tiles (P,).
    """

    rest: Floats
    speed: Floats
    shown: Floats
    tiles: NDArray[np.int64]

    @classmethod
    def of(
        cls, twin: Twin, scan: BenchScan, pixels: PixelIndices, index: int, turns: dict[Axis, Floats]
    ) -> _SetMotion | None:
        plan, bits = scan.session.plan, scan.compared_pass.settings.bits
        fringe, images = plan.sets[index], range(*plan.set_starts[index : index + 2])
        assert isinstance(fringe, FringeSet)
        raw = scan.levels(images, pixels)
        clear = raw.max(axis=0) < CLIPPED * full_scale(bits)
        if np.count_nonzero(clear) < LIMITS.min_pixels:
            return None
        levels = raw[:, clear] - twin.parameters.black_level * full_scale(bits)
        fitted, shift = fit_sinusoids(levels, fringe), fringe.phase_shifts()
        beyond, (light, by_phase) = beyond_fringe(shift), fringe_levels(fitted, shift)
        by_mm = by_phase * TWO_PI * fringe.stripes * turns[fringe.axis][clear]
        _, cosine, sine = fitted
        steady = _Steady.of(beyond, light, shift, np.hypot(cosine, sine), np.arctan2(sine, cosine))
        frames = np.arange(len(shift)) - 0.5 * (len(shift) - 1)
        shown = np.stack(
            [steady.without(np.outer(column, values)) for column, values in zip(beyond.T, by_mm, strict=True)]
        )
        tiles = tile_numbers((pixels[0][clear], pixels[1][clear]))
        return cls(steady.without(beyond @ levels), np.tensordot(frames, shown, 1), shown, tiles)


@dataclass(frozen=True, eq=False)
class _Steady:
    """What frames have without a motion: factors of their light, and harmonics of the response.

    columns (N P, C).
    """

    columns: Floats
    inverse: Floats

    @classmethod
    def of(cls, beyond: Floats, light: Floats, shift: Floats, amplitude: Floats, phase: Floats) -> _Steady:
        gains = [np.outer(column, values) for column, values in zip(beyond.T, light, strict=True)]
        second = [beyond @ (amplitude * wave(2 * (shift[:, None] - phase))) for wave in (np.cos, np.sin)]
        columns = np.stack([values.ravel() for values in (*gains, *second)], axis=1)
        return cls(columns, np.linalg.pinv(columns.T @ columns, rcond=1e-9, hermitian=True))

    def without(self, values: Floats) -> Floats:
        flat = values.ravel()
        return np.asarray(flat - self.columns @ (self.inverse @ (self.columns.T @ flat))).reshape(
            values.shape
        )


def _turns(twin: Twin, scan: BenchScan, pixels: PixelIndices, axis: Axis) -> Floats:
    """Change (P,) of a projector coordinate, as a share of its axis, for 1 mm along the camera's axis."""
    calibration = twin.parameters.calibration
    points, normals = part_surface_seen(twin, scan, pixels)
    along = points * (normals[:, 2] / np.einsum("pi,pi->p", normals, points))[:, None]
    ends = [
        calibration.projector.project(points + side * LIMITS.step_mm * along, calibration.T_projector_camera)
        for side in (-0.5, 0.5)
    ]
    column = 0 if axis == "x" else 1
    return np.asarray(
        (ends[1] - ends[0])[:, column] / LIMITS.step_mm / axis_length(calibration.projector.size, axis)
    )


def _fit_common_speed(set_motions: Sequence[_SetMotion], now: TwinParameters) -> ScanMotion:
    rest = np.concatenate([part.rest.ravel() for part in set_motions])
    speed = np.concatenate([part.speed.ravel() for part in set_motions])
    weight = np.ones_like(rest)
    for _ in range(LIMITS.rounds):
        strength = float(np.sum(weight * speed**2))
        v = float(np.sum(weight * speed * rest)) / max(strength, 1e-12)
        residual = rest - v * speed
        weight = huber_weights(residual, robust_spread(residual))
    tiles = np.concatenate([np.tile(part.tiles, len(part.rest)) for part in set_motions])
    scores = (weight * speed * residual)[:, None]
    by_rest = float(multiway_covariance(np.array([[1.0 / max(strength, 1e-12)]]), scores, [tiles])[0, 0])
    # The speed that a displacement of a single frame looks like, whose sizes vibration draws.
    ends = np.cumsum([0, *(part.rest.size for part in set_motions)])
    looks_like = [
        np.sum((weight * speed)[first:end] * shown.ravel()) / max(strength, 1e-12)
        for part, first, end in zip(set_motions, ends[:-1], ends[1:], strict=True)
        for shown in part.shown
    ]
    along = now.vibration_mm**2 + now.vibration_line_mm[2] ** 2
    by_vibration = along * float(np.sum(np.square(looks_like)))
    return ScanMotion(1e3 * v, 1e3 * float(np.sqrt(by_rest + by_vibration)))
