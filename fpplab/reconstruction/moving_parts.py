"""Parts that move evenly while they are scanned: which pixels they are, and by how much they move.

The residuals of still and of followed pixels tell a part from what stands still.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import scipy  # whose parts are loaded where something moves
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from fpplab.core.conventions import AXES, TWO_PI, Floats, Image, Mask, axis_length
from fpplab.patterns.recording import Recording
from fpplab.phase.common_errors import beyond_fringe
from fpplab.phase.limits import MOTION
from fpplab.reconstruction.following import (
    Follower,
    Pixels,
    displacement_cost,
    fit_displacement,
    is_even_motion,
    patches_about,
    pixels_that_follow,
    runs_forward,
    shares_of_scan,
)


@dataclass(frozen=True, eq=False)
class MovingTiles:
    """Square tiles of the image whose frames a motion explains."""

    corners: NDArray[np.intp]  # (T, 2) of those that move, row and column
    groups: NDArray[np.intp]  # (T,) which neighbouring ones are a part, from 1
    rates: Floats  # (C,) displacements of the coordinate along the first axis over the scan that were tried
    powers: Floats  # (T, C) what sinusoids leave at each
    variance: float  # of the noise of a level

    @classmethod
    def of(cls, recording: Recording) -> MovingTiles | None:
        """Look for tiles that move; None where too few do."""
        plan, side, axis = recording.plan, MOTION.tile_px, recording.plan.axes[0]
        height, width = recording.frames[0].shape
        apart = side * max(1, round(np.sqrt(height * width / side**2 / MOTION.max_tiles)))
        rows, columns = (np.arange(0, size - side + 1, apart) for size in (height, width))
        used = [k for k in plan.sets_along(axis) if plan.fringes[k].images > 3]
        if not used or not len(rows) or not len(columns):
            return None
        finest, shares = plan.fringes[plan.finest_set(axis)].stripes, shares_of_scan(recording)
        turns = np.arange(-MOTION.max_fringes, MOTION.max_fringes + 1e-9, MOTION.fringes_step)
        powers, strengths = np.zeros((len(rows), len(columns), len(turns))), []
        for k in used:
            fringe, (first, end) = plan.fringes[k], plan.set_starts[k : k + 2]
            products = _products(recording.frames[first:end], apart)
            ways = np.outer(turns, shares[first:end] - shares[first:end].mean())
            kept = beyond_fringe(fringe.phase_shifts() - TWO_PI * fringe.stripes / finest * ways)
            powers += np.einsum("tnm,rcnm->rct", kept, products)
            strengths.append(np.trace(products, axis1=2, axis2=3) * 2.0 / fringe.images / side**2)
        freedom = side**2 * sum(plan.fringes[k].images - 3 for k in used)
        still, best = powers[..., len(turns) // 2], powers.min(axis=-1)
        min_power = freedom * MOTION.min_variance / recording.grey**2
        # A set whose fringes move as a part does shows none there.
        lit = np.max(strengths, axis=0) >= (plan.masks.modulation_min / recording.grey) ** 2
        rates = turns * axis_length(recording.projector_size, axis) / finest
        moved = turns[powers.argmin(axis=-1)]
        moves = (
            lit & (np.abs(moved) >= MOTION.min_fringes) & (still > MOTION.min_power_ratio * best + min_power)
        )
        walk_px = np.median(np.abs(moved[moves])) * rates[-1] / turns[-1] if moves.any() else 0.0
        if moves.sum() > MOTION.whole_share * lit.sum() and walk_px < MOTION.max_walk_px:
            return None  # the projector's picture may walk as far
        groups, count = scipy.ndimage.label(moves, np.ones((3, 3)))
        moves &= np.bincount(groups.ravel(), minlength=count + 1)[groups] >= MOTION.min_tiles
        if not moves.any():
            return None
        at, variance = np.argwhere(moves), max(float(np.median(best[moves])), min_power) / freedom
        corners = np.stack([rows[at[:, 0]], columns[at[:, 1]]], axis=1)
        return cls(corners, groups[moves], rates, powers[moves], variance)

    def mask(self, group: int, shape: tuple[int, ...]) -> Mask:
        """All pixels of a group's tiles."""
        mask = np.zeros(shape, np.bool_)
        for row, column in self.corners[self.groups == group]:
            mask[row : row + MOTION.tile_px, column : column + MOTION.tile_px] = True
        return mask

    def pixels(self, group: int, max_count: int) -> Pixels:
        """Some pixels of a group, (P, 2) row and column."""
        inner = np.indices((MOTION.tile_px, MOTION.tile_px)).reshape(2, -1).T
        pixels = (self.corners[self.groups == group][:, None] + inner).reshape(-1, 2)
        return np.asarray(np.random.default_rng(0).permutation(pixels)[:max_count])


def _products(frames: Sequence[Image], apart: int) -> Floats:
    """Products of frames less their mean, summed over square tiles so far apart: (rows, columns, N, N)."""
    side = (MOTION.tile_px, MOTION.tile_px)
    tiles = [sliding_window_view(frame, side)[::apart, ::apart] for frame in frames]
    levels = np.stack(tiles, axis=2, dtype=np.float32)
    levels -= levels.mean(axis=2, keepdims=True)
    levels = levels.reshape(*levels.shape[:3], -1)
    return np.asarray(levels @ np.swapaxes(levels, -1, -2), np.float64)


@dataclass(frozen=True, eq=False)
class MovingPart:
    """A part that moves."""

    moved: Floats  # (3,) mm over the scan
    covariance: Floats
    mask: Mask  # its pixels
    swept: Mask  # those nearby that neither follow it nor stand still
    residual_ratio: float  # mean square of what it leaves, typically, over that of noise
    moving: Mask  # pixels of tiles that move
    measured: Mask | None = None  # pixels that became points once compensated, when that is known

    @property
    def is_followed(self) -> bool:
        """Whether what moves follows the displacement, and not a small part of it alone."""
        return bool(self.mask[self.moving].mean() >= MOTION.min_followed_share)

    @property
    def judged(self) -> MovingPart:
        """With all that moves where most of it does not follow."""
        return self if self.is_followed else replace(self, mask=self.mask | self.moving)


def find_moving_parts(follower: Follower, tiles: MovingTiles) -> list[MovingPart]:
    """Find the parts that tiles lie on; what vibrates is none."""
    regions, taken = list[MovingPart](), np.zeros(follower.depth.shape, np.bool_)
    for group in np.unique(tiles.groups):
        seeds = tiles.pixels(group, MOTION.fitted_pixels)
        if taken[tuple(seeds.T)].mean() > 0.5:  # beside another group of the same part
            continue
        few = seeds[: MOTION.trial_pixels]
        moving = tiles.mask(group, taken.shape) & ~taken
        trials = list(_start_displacements(follower, tiles, group, few))
        if follower.inverse_depths is None:
            start, local = _start(follower, trials, few), follower
        else:
            start, local = _start_in_range(follower, trials, few)
            near = scipy.ndimage.binary_dilation(moving, iterations=MOTION.margin_px)
            depth = local.with_likely_depths(np.argwhere(near), start).depth
            local = local.at_depth(scipy.ndimage.median_filter(depth, MOTION.median_px))
        region = _region(local, start, seeds, taken, MOTION.window_px, moving)
        if is_even_motion(local, region.moved, np.argwhere(region.judged.mask)):
            regions.append(region)
            taken |= region.judged.mask
    return regions


def _start(follower: Follower, trials: Sequence[Floats], few: Pixels) -> Floats:
    """Refine the displacements of least cost, and choose one."""
    costs = [displacement_cost(follower, trial, few) for trial in trials]
    best = [fit_displacement(follower, trials[k], few)[0] for k in np.argsort(costs)[: MOTION.refined_trials]]
    return min(best, key=lambda m: (not runs_forward(follower, m, few), displacement_cost(follower, m, few)))


def _start_in_range(follower: Follower, trials: Sequence[Floats], few: Pixels) -> tuple[Floats, Follower]:
    """The same where orders, and so depths, depend on the displacement: each has those that suit it best."""
    assert follower.inverse_depths is not None
    follower = follower.at_depth(np.full(follower.depth.shape, 1.0 / follower.inverse_depths[1]))

    def cost(moved: Floats, patches: int) -> float:
        residual = follower.likely(patches_about(few[:patches], follower.depth.shape), moved)[1].residual
        return float(np.median(np.sum(residual**2, axis=0)))  # pixels that the part passed by do not count

    best = []
    for k in np.argsort([cost(trial, MOTION.trial_patches) for trial in trials])[: MOTION.refined_trials]:
        best += [trials[k], fit_displacement(follower.with_likely_depths(few, trials[k]), trials[k], few)[0]]
    return min(best, key=lambda moved: cost(moved, MOTION.refined_patches)), follower


def refitted(follower: Follower, region: MovingPart) -> MovingPart:
    """Fit a part once more by its inner pixels."""
    mask = region.judged.mask
    inner = np.argwhere(scipy.ndimage.binary_erosion(mask, np.ones((MOTION.window_px, MOTION.window_px))))
    seeds = np.random.default_rng(0).permutation(inner if len(inner) else np.argwhere(mask))
    seeds = seeds[: MOTION.fitted_pixels]
    return _region(follower, region.moved, seeds, np.zeros_like(mask), 3, region.moving)


def _region(
    follower: Follower, start: Floats, seeds: Pixels, taken: Mask, window_px: int, moving: Mask
) -> MovingPart:
    """Refine a displacement by pixels that follow it, and tell which pixels do."""
    power = np.square(follower.residuals(seeds, start)).sum(axis=0)
    seeds = seeds[power <= MOTION.outlier_ratio * np.median(power)]
    moved, covariance = fit_displacement(follower, start, seeds)
    residual = np.median(np.square(follower.residuals(seeds, moved)).sum(axis=0)) / follower.freedom
    mask, swept = pixels_that_follow(follower, seeds, moved, window_px)
    return MovingPart(moved, covariance, mask & ~taken, swept, float(residual), moving)


def _start_displacements(
    follower: Follower, tiles: MovingTiles, group: int, pixels: Pixels
) -> Iterator[Floats]:
    """Displacements to begin with: along the axis as the tiles tell, and across it."""
    powers = tiles.powers[tiles.groups == group]
    curve = (powers / powers.min(axis=1, keepdims=True)).mean(axis=0)
    inner = np.flatnonzero((curve[1:-1] <= curve[:-2]) & (curve[1:-1] <= curve[2:])) + 1
    rates = [0.0, *tiles.rates[inner[np.argsort(curve[inner])[: MOTION.axial_trials]]]]
    rig, points = follower.calibration, follower.points(pixels)
    axis = AXES.index(follower.recording.plan.axes[0])

    def change(step: Floats) -> float:
        ahead, behind = (
            rig.projector.project(points + s * step, rig.T_projector_camera)[..., axis] for s in (0.5, -0.5)
        )
        return float(np.median(ahead - behind))

    per_mm = np.array([change(step) for step in np.eye(3)])
    along_ray = change(np.median(points, axis=0) / np.median(points[:, 2]))
    period = abs(tiles.rates[-1]) / MOTION.max_fringes / np.hypot(*per_mm[:2])
    across = np.linspace(-2.0, 2.0, MOTION.trials_across)
    for rate, x, y in product(rates, across, across[::2]):
        yield np.array([x * period, y * period, rate / along_ray])
