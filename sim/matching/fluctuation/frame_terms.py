"""What every frame of the bench has beyond the twin's: more light, other light of the room, a displacement.

Each is common to many thousands of pixels, so that least squares find it: frame n of a pose is

    E_n + gain_n P_n + room_n R + move_n · ∂E_n

with the expected image E_n of the twin, its parts by the projector P_n and by the room R, and its derivatives
by a displacement of the board. Unlike a fit of the phase steps alone it also sees what is in step with these.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.plan import Plan
from fpplab.phase.common_errors import beyond_fringe
from sim.effects import EFFECTS
from sim.matching.fluctuation.frame_series import Series
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

GAIN, ROOM, MOVES = (0,), (1,), (2, 3, 4)
"""Columns of a frame's terms: share of the projector's light, of the room's light, and mm along the axes."""


@dataclass(frozen=True, eq=False)
class FrameTerms:
    """Terms of the frames of a pose."""

    pose: int  # index of the pose
    frames: Floats  # numbers (n,) of the frames in the session
    sets: NDArray[np.int64]  # fringe set (n,) of each frame
    values: Floats  # (n, 5)
    covariance: Floats  # (n, 5, n, 5), by all that the fit leaves. Residuals within a tile count as dependent
    room_share: float  # share of the room's light in the mean level above black

    def series(self, columns: Sequence[int]) -> Series:
        of, size = list(columns), len(self.frames) * len(columns)
        # Faults of the fit are a share of the level, whichever light they are taken for.
        shares = {GAIN[0]: 1.0, ROOM[0]: max(self.room_share, LIMITS.min_room_share)}
        min_variance = (LIMITS.min_gain / shares[of[0]]) ** 2 if of[0] in shares else 0.0
        covariance = self.covariance[:, of][..., of].reshape(size, size) + min_variance * np.eye(size)
        return Series(self.frames, self.sets, self.values[:, of], covariance)


def terms_of_pose(reference: Reference, twin: Twin, pose: int) -> FrameTerms:
    now, images, sets = twin.parameters, *_images_of_finest_sets(reference)
    board = board_mask(now.calibration.camera, now.poses[pose], reference.target)
    pixels = subsample_pixels(board, LIMITS.max_pixels)
    first = reference.shown(images[:1])
    expected, gradient = levels_with_gradient(reference, twin, pose, images, pixels)
    dark = replace(now, ambient=0.0)
    for effect in EFFECTS:
        dark = effect.without(dark) if effect.is_room_light else dark
    in_dark_room = twin.with_parameters(dark)
    room = expected[0] - in_dark_room.expected_at(pose, first, reference.settings, pixels)[0]
    slopes = slopes_by_move(pixels, now.calibration, now.poses[pose], gradient)
    above = expected - now.black_level * reference.full_scale
    share = float(room.mean() / above.mean())
    projected = above - room
    other = room if share > LIMITS.min_room_share else np.ones_like(room)
    frames = reference.frames(pose, images)[:, *pixels].astype(np.float64)
    bases = [np.column_stack([light, other, slope]) for light, slope in zip(projected, slopes, strict=True)]
    differences = frames - expected - change_by_bend(reference, now, pose, pixels, slopes)
    fits = [_fit_differences(off, basis) for off, basis in zip(differences, bases, strict=True)]
    values = np.array([coefficients for coefficients, _ in fits])
    residuals, tiles = np.array([rest for _, rest in fits]), tile_numbers(pixels)
    changing = _remove_constant_part(residuals, reference.plan, sets)
    covariance = _of_each_frame([_tile_errors(*of, tiles) for of in zip(changing, bases, strict=True)])
    covariance += _of_shared_fringe(residuals, bases, tiles, reference.plan, sets)
    room_share = share if share > LIMITS.min_room_share else 0.0
    return FrameTerms(pose, np.array(images, np.float64), sets, values, covariance, room_share)


def _images_of_finest_sets(reference: Reference) -> tuple[tuple[int, ...], NDArray[np.int64]]:
    steps = [
        (n, index) for n, (index, _, _) in enumerate(reference.plan.steps()) if index in reference.finest_sets
    ]
    images, sets = zip(*steps, strict=True)
    return images, np.array(sets, np.int64)


def _fit_differences(differences: Floats, columns: Floats) -> tuple[Floats, Floats]:
    """Fit differences (P,) by a basis (P, 5); the coefficients (5,), and what they leave (P,)."""
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
    """Give by how much residuals (P,) of each tile displace the coefficients, (`TILES`², 5)."""
    size = _sizes(basis)
    scaled = basis / size
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=1e-10)
    scores = np.array([np.bincount(tiles, column, TILES**2) for column in (scaled * residual[:, None]).T])
    return np.asarray((inverse @ scores).T / size)


def _of_each_frame(errors: Sequence[Floats]) -> Floats:
    """Covariance (n, 5, n, 5) of coefficients by errors (tiles, 5) that are others in every frame."""
    count, size = len(errors), errors[0].shape[1]
    covariance = np.zeros((count, size, count, size))
    for n, error in enumerate(errors):
        of_frame = error.T @ error
        covariance[n, :, n] = of_frame + 1e-12 * np.diag(np.diagonal(of_frame)) + 1e-300 * np.eye(size)
    return covariance


def _of_shared_fringe(
    residuals: Floats, bases: Sequence[Floats], tiles: NDArray[np.int64], plan: Plan, sets: NDArray[np.int64]
) -> Floats:
    """Covariance (n, 5, n, 5) by fringes that the twin has elsewhere, or of another size, in all frames.

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
