"""What every frame of the bench has beyond the twin's: more light, other light of the room, a displacement.

Each is common to many thousands of pixels, so that least squares find it: frame n of a pose is

    E_n + gain_n P_n + (room_n + gradient_n y) R + move_n · ∂E_n

with the expected image E_n of the twin, its parts by the projector P_n and by the room R, the row y from -1
to 1, and the derivatives of E_n by a displacement of the board. Unlike a fit of the phase steps alone it also
sees what is in step with these.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, PixelIndices
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.plan import Plan
from fpplab.phase.common_errors import beyond_fringe
from sim.effects import EFFECTS
from sim.effects.step import RoomSource
from sim.matching.fluctuation.frame_series import RowProfile, Series
from sim.matching.geometry.board_shape import change_by_bend
from sim.matching.geometry.geometry_fit import levels_with_gradient
from sim.matching.geometry.surface_points import slopes_by_move
from sim.matching.loss import board_mask, subsample_pixels
from sim.matching.reference import Reference
from sim.matching.samples import TILES, tile_numbers
from sim.twin import Twin


@dataclass(frozen=True)
class TermLimits:
    """How finely the terms of frames are estimated."""

    max_pixels: int = 15_000  # of each pose that are compared (chosen)
    min_gain: float = 3e-4  # of the projector's light, relative; faults of the fit look like less (chosen)
    min_room_share: float = 1e-3  # of the level; changes of less light of the room cannot be seen (chosen)


LIMITS = TermLimits()

GAIN, ROOM, ROOM_ROWS, MOVES = (0,), (1,), (1, 2), (3, 4, 5)
"""Columns of a frame's terms: share of the projector's light, of the room's light without and with its
gradient along the rows, and mm along the axes."""


@dataclass(frozen=True, eq=False)
class FrameTerms:
    """Terms of the frames of a pose."""

    pose: int  # index of the pose
    frames: Floats  # numbers (n,) of the frames in the session
    sets: NDArray[np.int64]  # fringe set (n,) of each frame
    values: Floats  # (n, 6)
    covariance: Floats  # (n, 6, n, 6), by all that the fit leaves. Residuals within a tile count as dependent
    room_share: float  # share of the room's light in the mean level above black
    profile: RowProfile  # of the room's light
    source: RoomSource = "all"  # of the room's light
    of_sources: tuple[FrameTerms, ...] = ()  # the same with one source alone, where the room has two

    def series(self, columns: Sequence[int]) -> Series:
        of, size = list(columns), len(self.frames) * len(columns)
        # Faults of the fit are a share of the level, whichever light they are taken for.
        shares = {GAIN[0]: 1.0, ROOM[0]: max(self.room_share, LIMITS.min_room_share)}
        min_variance = (LIMITS.min_gain / shares[of[0]]) ** 2 if of[0] in shares else 0.0
        covariance = self.covariance[:, of][..., of].reshape(size, size) + min_variance * np.eye(size)
        profile = self.profile if tuple(columns) == ROOM_ROWS else None
        return Series(self.frames, self.sets, self.values[:, of], covariance, profile)


def terms_of_pose(reference: Reference, twin: Twin, pose: int) -> FrameTerms:
    now, images, sets = twin.parameters, *_images_of_finest_sets(reference)
    board = board_mask(now.calibration.camera, now.poses[pose], reference.target)
    pixels = subsample_pixels(board, LIMITS.max_pixels)
    first = reference.shown(images[:1])
    expected, gradient = levels_with_gradient(reference, twin, pose, images, pixels)
    without_lamps = now
    for effect in EFFECTS:
        without_lamps = effect.without(without_lamps) if effect.is_room_light else without_lamps
    even_alone, none = (
        twin.with_parameters(other).expected_at(pose, first, reference.settings, pixels)[0]
        for other in (without_lamps, replace(without_lamps, ambient=0.0))
    )
    room, even = expected[0] - none, even_alone - none
    slopes = slopes_by_move(pixels, now.calibration, now.poses[pose], gradient)
    above = expected - now.black_level * reference.full_scale
    frames = reference.frames(pose, images)[:, *pixels].astype(np.float64)
    differences = frames - expected - change_by_bend(reference, now, pose, pixels, slopes)
    seen = _SeenFrames(
        pose, images, sets, reference.plan, pixels, differences, above - room, slopes, above.mean()
    )
    sources: dict[RoomSource, Floats] = {"lamps": room - even, "even": even}
    shown = {name: light for name, light in sources.items() if light.mean() > seen.min_room_level}
    of_sources = [seen.terms(light, name) for name, light in shown.items()] if len(shown) > 1 else []
    return replace(seen.terms(room, "all"), of_sources=tuple(of_sources))


@dataclass(frozen=True, eq=False)
class _SeenFrames:
    """What terms are fitted to: differences (n, P) from the twin, and what these are taken for."""

    pose: int
    images: tuple[int, ...]
    sets: NDArray[np.int64]
    plan: Plan
    pixels: PixelIndices
    differences: Floats
    projected: Floats  # (n, P) light of the projector
    slopes: Floats  # (n, P, 3) by displacements
    level: float  # mean above black

    @property
    def min_room_level(self) -> float:
        return LIMITS.min_room_share * self.level

    def terms(self, room: Floats, source: RoomSource) -> FrameTerms:
        """Fit the terms if this light (P,) of the room is what changes."""
        is_seen = float(room.mean()) > self.min_room_level
        other = room if is_seen else np.ones_like(room)
        profile = RowProfile.of(self.pixels[0], other)
        of_room = np.column_stack([other, other * profile.gradient(self.pixels[0])])
        parts = zip(self.projected, self.slopes, strict=True)
        bases = [np.column_stack([light, of_room, slope]) for light, slope in parts]
        fits = [_fit_differences(off, basis) for off, basis in zip(self.differences, bases, strict=True)]
        values = np.array([coefficients for coefficients, _ in fits])
        residuals, tiles = np.array([rest for _, rest in fits]), tile_numbers(self.pixels)
        changing = _remove_constant_part(residuals, self.plan, self.sets)
        covariance = _of_each_frame([_tile_errors(*of, tiles) for of in zip(changing, bases, strict=True)])
        covariance += _of_shared_fringe(residuals, bases, tiles, self.plan, self.sets)
        share = float(room.mean()) / self.level if is_seen else 0.0
        frames = np.array(self.images, np.float64)
        return FrameTerms(self.pose, frames, self.sets, values, covariance, share, profile, source)


def _images_of_finest_sets(reference: Reference) -> tuple[tuple[int, ...], NDArray[np.int64]]:
    steps = [
        (n, index) for n, (index, _, _) in enumerate(reference.plan.steps()) if index in reference.finest_sets
    ]
    images, sets = zip(*steps, strict=True)
    return images, np.array(sets, np.int64)


def _fit_differences(differences: Floats, columns: Floats) -> tuple[Floats, Floats]:
    """Fit differences (P,) by a basis (P, 6); the coefficients (6,), and what they leave (P,)."""
    size = _sizes(columns)
    coefficients = np.linalg.lstsq(columns / size, differences, rcond=1e-6)[0] / size
    return coefficients, differences - columns @ coefficients


def _sizes(basis: Floats) -> Floats:
    size = np.sqrt(np.mean(basis**2, axis=0))
    return np.asarray(np.where(size == 0, 1.0, size))


def _remove_constant_part(residuals: Floats, plan: Plan, sets: NDArray[np.int64]) -> Floats:
    """Take off what of each pixel (n, P) is in every frame of a set: another offset, or another fringe."""
    changing = residuals.copy()
    for number in np.unique(sets):
        of, fringe = sets == number, plan.sets[number]
        if not isinstance(fringe, FringeSet):
            continue  # what a code has elsewhere in all frames is not told from what changes
        shift = fringe.phase_shifts()
        beyond = beyond_fringe(shift)
        freedom = max(float(np.trace(beyond)), 1.0)
        changing[of] = (
            np.sqrt(len(shift) / freedom) * (beyond @ residuals[of]) if freedom > 1 else residuals[of]
        )
    return changing


def _tile_errors(residual: Floats, basis: Floats, tiles: NDArray[np.int64]) -> Floats:
    """Give by how much residuals (P,) of each tile displace the coefficients, (`TILES`², 6)."""
    size = _sizes(basis)
    scaled = basis / size
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10)
    scores = np.array([np.bincount(tiles, column, TILES**2) for column in (scaled * residual[:, None]).T])
    return np.asarray((inverse @ scores).T / size)


def _of_each_frame(errors: Sequence[Floats]) -> Floats:
    """Covariance (n, 6, n, 6) of coefficients by errors (tiles, 6) that are others in every frame."""
    count, size = len(errors), errors[0].shape[1]
    covariance = np.zeros((count, size, count, size))
    for n, error in enumerate(errors):
        of_frame = error.T @ error
        covariance[n, :, n] = of_frame + 1e-12 * np.diag(np.diagonal(of_frame)) + 1e-300 * np.eye(size)
    return covariance


def _of_shared_fringe(
    residuals: Floats, bases: Sequence[Floats], tiles: NDArray[np.int64], plan: Plan, sets: NDArray[np.int64]
) -> Floats:
    """Covariance (n, 6, n, 6) by fringes that the twin has elsewhere, or of another size, in all frames.

    What they are taken for goes once or twice through its period while the phase does once, with a phase that
    chance decides.
    """
    count, size = len(residuals), bases[0].shape[1]
    covariance = np.zeros((count, size, count, size))
    for number in np.unique(sets):
        of, fringe = np.flatnonzero(sets == number), plan.sets[number]
        if not isinstance(fringe, FringeSet):
            continue
        shift = fringe.phase_shifts()
        shared = residuals[of] - beyond_fringe(shift) @ residuals[of]
        errors = np.array([_tile_errors(rest, bases[n], tiles) for n, rest in zip(of, shared, strict=True)])
        for harmonic in (1, 2):
            turn = harmonic * shift
            waves = np.linalg.qr(np.column_stack([np.cos(turn), np.sin(turn)]))[0]
            amplitudes = np.einsum("nw,ntc->wtc", waves, errors)
            of_wave = np.einsum("wtc,wtd->cd", amplitudes, amplitudes) / 2.0
            by_frame = np.einsum("nw,mw,cd->nmcd", waves, waves, of_wave)
            covariance[of[:, None], :, of[None, :]] += by_frame
    return covariance
