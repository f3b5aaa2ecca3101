"""Parts that move evenly while they are scanned: their frames as if they had stood still.

A part that moves shows each frame of a fringe set at another phase. A sinusoid then leaves a residual of its
frames, which vanishes where they are followed along the right displacement and fitted at the phases at which
they were taken. The displacement is one vector for all pixels of a part; the residuals of still and of
followed pixels tell the part from what stands still. Everything is given for the middle of the finest set.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, product

import numpy as np
import scipy  # whose parts are loaded where something moves
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import AXES, TWO_PI, Floats, Image, Map, Mask, axis_length, full_scale
from fpplab.core.errors import FppError
from fpplab.patterns.motion import Compensation, PartMotion
from fpplab.patterns.recording import Recording
from fpplab.patterns.unwrapping import unwrapping_methods
from fpplab.phase import decode
from fpplab.phase.common_errors import beyond_fringe
from fpplab.phase.limits import COMMON_ERRORS, MOTION
from fpplab.reconstruction.depth_range import decoding_bounds
from fpplab.reconstruction.likely_depths import LikelyDepths, likely_depths
from fpplab.reconstruction.points import triangulate
from fpplab.reconstruction.triangulation import camera_rays

Pixels = NDArray[np.intp]  # (P, 2) row and column


def compensate_motion(recording: Recording, calibration: Calibration) -> Recording:
    """Give the frames of parts that move as those of parts at rest; the same recording where none does."""
    plan = recording.plan
    if recording.merged or recording.bayer or plan.fringe_part is not plan or recording.motion:
        return recording
    tiles = _Tiles.of(recording)
    depth = None if tiles is None else _depth(recording, calibration, rough=True)
    if tiles is None or depth is None:
        return recording
    noise = np.sqrt(tiles.variance / (4.0 * np.pi)) / MOTION.blur_px
    follower = _Follower(recording, calibration, depth[0], float(noise))
    regions = _regions(follower, tiles)
    if not regions:
        return recording
    for _ in range(MOTION.passes):
        depth, before = _depth(_as_at_rest(follower, regions), calibration, rough=False), regions
        if depth is None:
            break
        follower = follower.at_depth(depth[0])
        regions = [_refitted(follower, region) for region in regions]
        changes = [np.abs(a.moved - b.moved).max() for a, b in zip(before, regions, strict=True)]
        if max(changes) < MOTION.tolerance_mm:
            break
    depth = _depth(_as_at_rest(follower, regions), calibration, rough=False)
    measured = np.zeros(follower.depth.shape, np.bool_) if depth is None else depth[1]
    return _as_at_rest(follower, [replace(each, measured=measured & each.is_followed) for each in regions])


def _shares(recording: Recording) -> Floats:
    """When each frame was taken, as a share of the time from the first to the last, less the middle set's."""
    plan, count = recording.plan, recording.plan.images
    times = np.array(recording.times_s if len(recording.times_s) == count else range(count), np.float64)
    finest = plan.finest_set(plan.axes[0])
    middle = times[plan.set_starts[finest] : plan.set_starts[finest + 1]].mean()
    return np.asarray((times - middle) / max(times[-1] - times[0], 1e-12))


@dataclass(frozen=True, eq=False)
class _Tiles:
    """Square tiles of the image whose frames a motion explains."""

    corners: NDArray[np.intp]  # (T, 2) of those that move, row and column
    groups: NDArray[np.intp]  # (T,) which neighbouring ones are a part, from 1
    rates: Floats  # (C,) displacements of the coordinate along the first axis over the scan that were tried
    powers: Floats  # (T, C) what sinusoids leave at each
    variance: float  # of the noise of a level

    @classmethod
    def of(cls, recording: Recording) -> _Tiles | None:
        """Look for tiles that move; None where too few do."""
        plan, side, axis = recording.plan, MOTION.tile_px, recording.plan.axes[0]
        height, width = recording.frames[0].shape
        apart = side * max(1, round(np.sqrt(height * width / side**2 / MOTION.max_tiles)))
        rows, columns = (np.arange(0, size - side + 1, apart) for size in (height, width))
        used = [k for k in plan.sets_along(axis) if plan.fringes[k].images > 3]
        if not used or not len(rows) or not len(columns):
            return None
        finest, shares = plan.fringes[plan.finest_set(axis)].stripes, _shares(recording)
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
        least = freedom * MOTION.min_variance / recording.grey**2
        # A set whose fringes move as a part does shows none there.
        lit = np.max(strengths, axis=0) >= (plan.masks.modulation_min / recording.grey) ** 2
        rates = turns * axis_length(recording.projector_size, axis) / finest
        moved = turns[powers.argmin(axis=-1)]
        moves = lit & (np.abs(moved) >= MOTION.min_fringes) & (still > MOTION.min_power_ratio * best + least)
        walk_px = np.median(np.abs(moved[moves])) * rates[-1] / turns[-1] if moves.any() else 0.0
        if moves.sum() > MOTION.whole_share * lit.sum() and walk_px < MOTION.max_walk_px:
            return None  # the projector's picture may walk as far
        groups, count = scipy.ndimage.label(moves, np.ones((3, 3)))
        moves &= np.bincount(groups.ravel(), minlength=count + 1)[groups] >= MOTION.min_tiles
        if not moves.any():
            return None
        at, variance = np.argwhere(moves), max(float(np.median(best[moves])), least) / freedom
        corners = np.stack([rows[at[:, 0]], columns[at[:, 1]]], axis=1)
        return cls(corners, groups[moves], rates, powers[moves], variance)

    def mask(self, group: int, shape: tuple[int, ...]) -> Mask:
        """All pixels of a group's tiles."""
        mask = np.zeros(shape, np.bool_)
        for row, column in self.corners[self.groups == group]:
            mask[row : row + MOTION.tile_px, column : column + MOTION.tile_px] = True
        return mask

    def pixels(self, group: int, most: int) -> Pixels:
        """Some pixels of a group, (P, 2) row and column."""
        inner = np.indices((MOTION.tile_px, MOTION.tile_px)).reshape(2, -1).T
        pixels = (self.corners[self.groups == group][:, None] + inner).reshape(-1, 2)
        return np.asarray(np.random.default_rng(0).permutation(pixels)[:most])


def _products(frames: Sequence[Image], apart: int) -> Floats:
    """Products of frames less their mean, summed over square tiles so far apart: (rows, columns, N, N)."""
    side = (MOTION.tile_px, MOTION.tile_px)
    tiles = [sliding_window_view(frame, side)[::apart, ::apart] for frame in frames]
    levels = np.stack(tiles, axis=2, dtype=np.float32)
    levels -= levels.mean(axis=2, keepdims=True)
    levels = levels.reshape(*levels.shape[:3], -1)
    return np.asarray(levels @ np.swapaxes(levels, -1, -2), np.float64)


def _depth(recording: Recording, calibration: Calibration, *, rough: bool) -> tuple[Floats, Mask] | None:
    """Distance of every pixel along the camera's axis, where motion spoils it by the median around it.

    Also which pixels became points that lie there, and not by whole periods beside it.
    """
    plan = recording.plan
    if rough:
        masks = plan.masks.model_copy(
            update={"disagreement_max": 1e6, "residual_max": 1e6, "wrong_order_max": 1.0, "contrast_min": 0.0}
        )
        plan = plan.model_copy(update={"masks": masks})
    try:
        decoded = decode(
            replace(recording, plan=plan, motion=None),
            bounds=decoding_bounds(plan, calibration, recording.depth),
        ).of_known_order()
        cloud = triangulate(decoded, calibration, normals=False)
    except FppError:
        return None
    if not len(cloud) or cloud.pixels is None:
        return None
    depth = np.full(recording.frames[0].shape, np.nan)
    u, v = cloud.pixels.astype(int).T
    depth[v, u] = cloud.points[:, 2]
    nearest = scipy.ndimage.distance_transform_edt(
        np.isnan(depth), return_distances=False, return_indices=True
    )
    around = np.asarray(scipy.ndimage.median_filter(depth[tuple(nearest)], MOTION.median_px))
    return around, np.abs(depth - around) <= MOTION.max_step_share * around


@dataclass(frozen=True, eq=False)
class _Follower:
    """Follows pixels of a part through the frames of a recording."""

    recording: Recording
    calibration: Calibration
    depth: Floats
    noise: float  # standard deviation of a level
    blur_px: float = MOTION.blur_px  # of the frames; interpolation would else take noise away where it moves

    @property
    def freedom(self) -> int:
        """How many combinations of a pixel's levels sinusoids of one offset leave."""
        fringes = self.recording.plan.fringes
        offsets = sum(fringe.stripes >= COMMON_ERRORS.min_stripes for fringe in fringes)
        return sum(max(fringe.images - 3, 0) for fringe in fringes) + max(offsets - 1, 0)

    @cached_property
    def shares(self) -> Floats:
        return _shares(self.recording)

    @cached_property
    def splines(self) -> list[Map]:
        levels = (
            scipy.ndimage.gaussian_filter(f.astype(np.float32), self.blur_px) for f in self.recording.frames
        )
        return [scipy.ndimage.spline_filter(each, output=np.float32) for each in levels]

    @cached_property
    def rays(self) -> Floats:
        return camera_rays(self.calibration.camera)

    def points(self, pixels: Pixels) -> Floats:
        own = tuple(pixels.T)
        return np.asarray(self.rays[own] * self.depth[own][:, None])

    def followed(self, pixels: Pixels, moved: Floats, k: int) -> tuple[Floats, Floats, Floats]:
        """Levels of set k where the pixels' points are seen, the shifts of these, and where that is."""
        # pixels (P, 2); moved (3,) mm over the scan; returns (N, P), (N, P) rad, (N, P, 2)
        offsets, shifts, _ = self.ways(self.points(pixels), moved, k)
        first, end = self.recording.plan.set_starts[k : k + 2]
        seen = offsets + pixels
        levels = [
            scipy.ndimage.map_coordinates(spline, at.T, prefilter=False, mode="nearest", output=np.float64)
            for spline, at in zip(self.splines[first:end], seen, strict=True)
        ]
        return np.stack(levels), shifts, np.asarray(seen)

    def ways(self, points: Floats, moved: Floats, k: int) -> tuple[Floats, Floats, Floats]:
        """By how much points are displaced in the camera's images of set k, their shifts, and their phase."""
        # points (P, 3); returns (N, P, 2) row and column, (N, P) rad, (P,) rad
        plan, rig = self.recording.plan, self.calibration
        fringe, (first, end) = plan.fringes[k], plan.set_starts[k : k + 2]
        axis = AXES.index(fringe.axis)
        # Over a few mm, ways through both images are parabolas.
        nodes = self.shares[[0, -1]]
        ends = points + nodes[:, None, None] * moved
        bend = np.stack([self.shares, self.shares**2], axis=1)[first:end] @ np.linalg.inv(
            np.stack([nodes, nodes**2], axis=1)
        )
        offsets = rig.camera.project(ends) - rig.camera.project(points)
        shown = [rig.projector.project(p, rig.T_projector_camera)[..., axis] for p in (*ends, points)]
        to_rad = TWO_PI * fringe.stripes / axis_length(self.recording.projector_size, fringe.axis)
        shifts = fringe.phase_shifts()[:, None] - to_rad * bend @ (np.stack(shown[:2]) - shown[2])
        phase = to_rad * (shown[2] + 0.5) + fringe.demodulation().origin_rad
        return np.asarray(np.tensordot(bend, offsets[..., ::-1], 1)), shifts, np.asarray(phase)

    def at_depth(self, depth: Floats) -> _Follower:
        """The same with another depth map."""
        other = replace(self, depth=depth)
        other.__dict__.update(rays=self.rays, splines=self.splines)
        return other

    @cached_property
    def inverse_depths(self) -> Floats | None:
        """Ends and middle of the range of depths that tells the orders; None where phases do."""
        recording = self.recording
        if recording.depth is None or not unwrapping_methods()[recording.plan.unwrapping].guided:
            return None
        near, far = recording.depth.mm
        return np.array([1.0 / near, 0.5 / near + 0.5 / far, 1.0 / far])

    def likely(self, pixels: Pixels, moved: Floats) -> tuple[Floats, LikelyDepths]:
        """Find the likeliest depths (P,) in mm of patches' pixels in that range."""
        assert self.inverse_depths is not None
        plan = self.recording.plan
        used = plan.sets_along(plan.axes[0])
        rays = self.rays[tuple(pixels.T)]
        phases = []
        for inverse in self.inverse_depths:
            ways = [self.ways(rays / inverse, moved, k) for k in used]
            phases.append(np.concatenate([phase - shifts for _, shifts, phase in ways]))
        (first, middle, last), (near, _, far) = phases, self.inverse_depths
        likely = likely_depths(
            np.concatenate([self.followed(pixels, moved, k)[0] for k in used]),
            np.stack([middle, 0.5 * (last - first), 0.5 * (last + first) - middle]),
            np.repeat(range(len(used)), [plan.fringes[k].images for k in used]),
        )
        return 2.0 / (near + far + (far - near) * likely.place), likely

    @cached_property
    def compared(self) -> list[int]:
        """Sets whose offset is the same but for the lamp's gain, none where there is only one."""
        fringes = self.recording.plan.fringes
        fine = [k for k, fringe in enumerate(fringes) if fringe.stripes >= COMMON_ERRORS.min_stripes]
        return fine if len(fine) > 1 else []

    def fits(self, pixels: Pixels, moved: Floats, *, gains: bool = True) -> list[_SetFit]:
        """Fit every set at the pixels; sets of one offset together, which uneven steps alone may not tell."""
        fits = [_fit(*self.followed(pixels, moved, k)) for k in range(len(self.recording.plan.fringes))]
        if not self.compared:
            return fits
        weights = {k: 1.0 / fits[k].inverse[:, 0, 0] for k in self.compared}
        mean = sum(w * fits[k].fitted[0] for k, w in weights.items()) / sum(weights.values())
        factors = {k: self._gain(fits[k], np.maximum(mean, 1e-9)) if gains else 1.0 for k in self.compared}
        variance = np.asarray(1.0 / sum(factors[k] ** 2 * w for k, w in weights.items()))
        offset = variance * sum(factors[k] * w * fits[k].fitted[0] for k, w in weights.items())
        for k, gain in factors.items():
            fits[k] = fits[k].with_offset(gain * offset, gain**2 * variance)
        return fits

    def _gain(self, fit: _SetFit, offset: Floats) -> float:
        """How much brighter a set is than others; as a lamp's usually is where its steps do not tell."""
        # Most pixels tell it, and not those that the part passed by.
        spread = self.noise * np.median(np.sqrt(fit.inverse[:, 0, 0]) / offset) / np.sqrt(len(offset))
        known = MOTION.gain_sigma**2 / (MOTION.gain_sigma**2 + spread**2)
        return float(1.0 + known * (np.median(fit.fitted[0] / offset) - 1.0))

    def residuals(self, pixels: Pixels, moved: Floats, *, gains: bool = True) -> Floats:
        """Compute what sinusoids and the lamp's gains leave of the followed levels, over their noise."""
        # returns (M, P)
        residuals = [
            _without_gains(fit.residual, fit.levels - fit.residual) if gains else fit.residual
            for k, fit in enumerate(self.fits(pixels, moved, gains=gains))
            if len(fit.levels) > 3 or k in self.compared
        ]
        return np.concatenate(residuals) / self.noise


def _without_gains(residual: Floats, levels: Floats) -> Floats:
    """Take off what each frame shows brighter than others at all pixels."""
    gains = np.sum(residual * levels, axis=1) / np.sum(levels**2, axis=1)
    return np.asarray(residual - gains[:, None] * levels)


@dataclass(frozen=True, eq=False)
class _SetFit:
    """A set's followed levels, fitted by `A + c cos + s sin` pixel by pixel."""

    levels: Floats  # (N, P)
    shifts: Floats  # (N, P) rad
    places: Floats  # (N, P, 2) row and column of where they were seen
    fitted: Floats  # (3, P)
    inverse: Floats  # (P, 3, 3) covariance for noise of 1

    @cached_property
    def residual(self) -> Floats:
        offset, c, s = self.fitted
        return np.asarray(self.levels - offset - c * np.cos(self.shifts) - s * np.sin(self.shifts))

    @cached_property
    def noise_ratio(self) -> Floats:
        """Noise of the phase, over that by even steps."""
        _, c, s = self.fitted
        along = np.stack([np.zeros_like(c), -s, c]) / np.maximum(np.hypot(c, s), 1e-9)
        squares = np.einsum("ip,pij,jp->p", along, self.inverse, along)
        return np.asarray(np.sqrt(0.5 * len(self.levels) * squares))

    def with_offset(self, offset: Floats, variance: Floats) -> _SetFit:
        """The same where the offset is known from all sets."""
        along = self.inverse[:, :, 0] / self.inverse[:, :1, 0]
        fitted = self.fitted + along.T * (offset - self.fitted[0])
        known = (self.inverse[:, 0, 0] - variance)[:, None, None]
        return replace(
            self, fitted=fitted, inverse=self.inverse - known * along[:, :, None] * along[:, None, :]
        )


def _fit(levels: Floats, shifts: Floats, places: Floats) -> _SetFit:
    waves = np.stack([np.ones_like(shifts), np.cos(shifts), np.sin(shifts)])
    normal = np.einsum("inp,jnp->pij", waves, waves) + 1e-6 * np.eye(3)
    inverse = np.linalg.inv(normal)
    fitted = np.einsum("pij,jnp,np->ip", inverse, waves, levels, optimize=True)
    return _SetFit(levels, shifts, places, fitted, inverse)


@dataclass(frozen=True, eq=False)
class _Region:
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
    def judged(self) -> _Region:
        """With all that moves where most of it does not follow."""
        return self if self.is_followed else replace(self, mask=self.mask | self.moving)


def _regions(follower: _Follower, tiles: _Tiles) -> list[_Region]:
    regions, taken = list[_Region](), np.zeros(follower.depth.shape, np.bool_)
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
            depth = _with_likely_depths(local, start, np.argwhere(near)).depth
            local = local.at_depth(scipy.ndimage.median_filter(depth, MOTION.median_px))
        region = _region(local, start, seeds, taken, MOTION.window_px, moving)
        if _is_even(local, region.moved, np.argwhere(region.judged.mask)):
            regions.append(region)
            taken |= region.judged.mask
    return regions


def _start(follower: _Follower, trials: Sequence[Floats], few: Pixels) -> Floats:
    """Refine the displacements of least cost, and choose one."""
    costs = [_cost(follower, trial, few) for trial in trials]
    best = [_minimum(follower, trials[k], few)[0] for k in np.argsort(costs)[: MOTION.refined_trials]]
    return min(best, key=lambda m: (not _runs_forward(follower, m, few), _cost(follower, m, few)))


def _start_in_range(follower: _Follower, trials: Sequence[Floats], few: Pixels) -> tuple[Floats, _Follower]:
    """The same where orders, and so depths, depend on the displacement: each has those that suit it best."""
    assert follower.inverse_depths is not None
    follower = follower.at_depth(np.full(follower.depth.shape, 1.0 / follower.inverse_depths[1]))

    def cost(moved: Floats, patches: int) -> float:
        left = follower.likely(_patches(few[:patches], follower.depth.shape), moved)[1].residual
        return float(np.median(np.sum(left**2, axis=0)))  # pixels that the part passed by do not count

    best = []
    for k in np.argsort([cost(trial, MOTION.trial_patches) for trial in trials])[: MOTION.refined_trials]:
        best += [trials[k], _minimum(_with_likely_depths(follower, trials[k], few), trials[k], few)[0]]
    return min(best, key=lambda moved: cost(moved, MOTION.refined_patches)), follower


def _with_likely_depths(follower: _Follower, moved: Floats, pixels: Pixels) -> _Follower:
    """The same with the most likely depths of patches about the pixels, and of those nearest to others."""
    depth, side = follower.depth.copy(), MOTION.patch_px
    squares = np.random.default_rng(0).permutation(np.unique(pixels // side, axis=0))[: MOTION.max_patches]
    patches = _patches(squares * side + side // 2, depth.shape)
    for first in range(0, len(patches), MOTION.patches * side**2):
        block = patches[first : first + MOTION.patches * side**2]
        depth[tuple(block.T)] = follower.likely(block, moved)[0]
    unknown = np.ones(depth.shape, np.bool_)
    unknown[tuple(patches.T)] = False
    if unknown[own := tuple(pixels.T)].any():
        nearest = scipy.ndimage.distance_transform_edt(unknown, return_distances=False, return_indices=True)
        depth[own] = depth[tuple(nearest[(slice(None), *own)])]
    return follower.at_depth(depth)


def _patches(centres: Pixels, shape: tuple[int, ...]) -> Pixels:
    """The pixels of squares about some, those of a square one after another."""
    half = MOTION.patch_px // 2
    around = np.stack(np.meshgrid(*2 * [np.arange(-half, half + 1)], indexing="ij"), axis=-1).reshape(-1, 2)
    inside = np.clip(centres, half, np.array(shape) - half - 1)
    return np.asarray((inside[:, None] + around).reshape(-1, 2))


def _refitted(follower: _Follower, region: _Region) -> _Region:
    """Fit a part once more by its inner pixels."""
    mask = region.judged.mask
    inner = np.argwhere(scipy.ndimage.binary_erosion(mask, np.ones((MOTION.window_px, MOTION.window_px))))
    seeds = np.random.default_rng(0).permutation(inner if len(inner) else np.argwhere(mask))
    seeds = seeds[: MOTION.fitted_pixels]
    return _region(follower, region.moved, seeds, np.zeros_like(mask), 3, region.moving)


def _region(
    follower: _Follower, start: Floats, seeds: Pixels, taken: Mask, window_px: int, moving: Mask
) -> _Region:
    """Refine a displacement by pixels that follow it, and tell which pixels do."""
    power = np.square(follower.residuals(seeds, start)).sum(axis=0)
    seeds = seeds[power <= MOTION.outlier_ratio * np.median(power)]
    moved, covariance = _minimum(follower, start, seeds)
    residual = np.median(np.square(follower.residuals(seeds, moved)).sum(axis=0)) / follower.freedom
    mask, swept = _part(follower, seeds, moved, window_px)
    return _Region(moved, covariance, mask & ~taken, swept, float(residual), moving)


def _is_even(follower: _Follower, moved: Floats, pixels: Pixels) -> bool:
    """Whether frames follow a displacement evenly, as by no vibration, and leave much less than at rest."""
    pixels = pixels[:: max(1, len(pixels) // MOTION.fitted_pixels)]
    still, followed = (np.square(follower.residuals(pixels, m)).sum(axis=0) for m in (np.zeros(3), moved))
    if np.median(still) < MOTION.min_power_ratio * np.median(followed):
        return False
    jitters, ways = list[Floats](), list[Floats]()
    for fringe, fit in zip(follower.recording.plan.fringes, follower.fits(pixels, moved), strict=True):
        if fringe.images > 3 and fringe.stripes >= COMMON_ERRORS.min_stripes:
            by_phase = fit.fitted[2] * np.cos(fit.shifts) - fit.fitted[1] * np.sin(fit.shifts)
            share = fringe.images / (fringe.images - 3) / np.sum(by_phase**2, axis=1)
            jitters.append(np.sum(fit.residual * by_phase, axis=1) * share)
            way = (fit.shifts - fringe.phase_shifts()[:, None]).mean(axis=1)
            ways.append(way - way.mean())
    jitter, way = (float(np.sqrt(np.mean(np.concatenate(each) ** 2))) for each in (jitters, ways))
    return jitter <= MOTION.max_jitter * way


def _runs_forward(follower: _Follower, moved: Floats, pixels: Pixels) -> bool:
    """Whether the phase runs along the image as the geometry says: mirrored steps leave as little."""
    plan = follower.recording.plan
    k, beside = plan.finest_set(plan.axes[0]), np.array([0, 1] if plan.axes[0] == "x" else [1, 0])

    def ahead(by: int) -> Pixels:
        return np.asarray(np.minimum(pixels + by * beside, np.array(follower.depth.shape) - 1))

    def wave(at: Pixels) -> Floats:
        return follower.fits(at, moved)[k].fitted

    rig, axis = follower.calibration, AXES.index(plan.axes[0])
    depth = np.median(follower.depth[tuple(pixels.T)])
    here, next_ = (
        rig.projector.project(depth * follower.rays[tuple(at.T)], rig.T_projector_camera)[..., axis]
        for at in (ahead(0), ahead(1))
    )
    size = axis_length(follower.recording.projector_size, plan.axes[0])
    per_px = TWO_PI * plan.fringes[k].stripes / size * float(np.median(next_ - here))
    by = max(1, round(0.5 * np.pi / max(abs(per_px), 1e-3)))
    (_, c, s), (_, c1, s1) = wave(ahead(0)), wave(ahead(by))
    return bool(np.sum((c1 + 1j * s1) * (c - 1j * s) * np.exp(-1j * by * per_px)).real > 0.0)


def _cost(follower: _Follower, moved: Floats, pixels: Pixels) -> float:
    """Half of what remains, in squares of its noise; outliers count by their size."""
    expected = 0.5 * np.square(moved / MOTION.prior_mm).sum()
    return _robust(follower.residuals(pixels, moved)) + float(expected)


def _robust(residuals: Floats) -> float:
    squares = np.sqrt(1.0 + np.square(residuals / MOTION.outlier_sigmas)) - 1.0
    return float(MOTION.outlier_sigmas**2 * squares.sum())


def _by_least_squares(follower: _Follower, start: Floats, pixels: Pixels) -> Floats:
    """Near the displacement that costs least, also from far away."""

    def values(moved: Floats) -> Floats:
        return np.asarray(np.append(follower.residuals(pixels, moved).ravel(), moved / MOTION.prior_mm))

    def slopes(moved: Floats) -> Floats:
        here, step = values(moved), MOTION.derivative_mm
        return np.asarray(np.stack([values(moved + step * e) - here for e in np.eye(3)], axis=1) / step)

    tolerance, most = MOTION.fit_tolerance, MOTION.fit_passes
    fit = scipy.optimize.least_squares(
        values,
        start,
        slopes,
        loss="soft_l1",
        f_scale=MOTION.outlier_sigmas,
        ftol=tolerance,
        xtol=tolerance,
        max_nfev=most,
    )
    return np.asarray(fit.x)


def _minimum(follower: _Follower, start: Floats, pixels: Pixels) -> tuple[Floats, Floats]:
    """The displacement that costs least, and its covariance."""
    # Least squares take slopes of the noise between pixels for those of the picture and slow down, so that
    # Newton's method comes last.
    moved, step = _by_least_squares(follower, start, pixels), MOTION.derivative_mm
    for _ in range(MOTION.newton_steps):
        here = _cost(follower, moved, pixels)
        ahead, behind = (
            np.array([_cost(follower, moved + s * e, pixels) for e in np.eye(3)]) for s in (step, -step)
        )
        bent = np.diag(ahead + behind - 2.0 * here)
        for i, j in combinations(range(3), 2):
            both = _cost(follower, moved + step * (np.eye(3)[i] + np.eye(3)[j]), pixels)
            bent[i, j] = bent[j, i] = both - ahead[i] - ahead[j] + here
        strength, directions = np.linalg.eigh(bent / step**2)
        inverse = (directions / np.maximum(np.abs(strength), MOTION.prior_mm**-2)) @ directions.T
        change = -inverse @ (ahead - behind) / (2.0 * step)
        change *= min(1.0, MOTION.max_step_mm / float(np.linalg.norm(change)))
        moved = moved + change
        if np.linalg.norm(change) < MOTION.tolerance_mm:
            break
    return moved, inverse


def _start_displacements(follower: _Follower, tiles: _Tiles, group: int, pixels: Pixels) -> Iterator[Floats]:
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


def _part(follower: _Follower, seeds: Pixels, moved: Floats, window_px: int) -> tuple[Mask, Mask]:
    """Which pixels follow a displacement and hang together, and which neither follow nor stand still."""
    part = np.zeros(follower.depth.shape, np.bool_)
    first = np.maximum(seeds.min(axis=0) - MOTION.margin_px, 0)
    end = np.minimum(seeds.max(axis=0) + MOTION.margin_px + 1, part.shape)
    nearby = np.stack(np.meshgrid(*(np.arange(a, b) for a, b in zip(first, end, strict=True)), indexing="ij"))
    blocks = np.array_split(nearby.reshape(2, -1).T, nearby[0].size // MOTION.block_pixels + 1)

    def left(displacement: Floats) -> Floats:
        power = [np.square(follower.residuals(b, displacement, gains=False)).sum(axis=0) for b in blocks]
        return np.asarray(
            scipy.ndimage.uniform_filter(np.concatenate(power).reshape(nearby[0].shape), window_px)
        )

    chance = MOTION.chance_sigmas * np.sqrt(2.0 * follower.freedom) / window_px
    still, followed = left(np.zeros(3)), left(moved)
    # Where the part passed by, neither fits.
    typical = np.median(followed[tuple((seeds - first).T)])
    fits = (followed < MOTION.outlier_ratio * typical) & (followed - still < chance)
    # Neither do they differ where a part without texture moves across; it goes on without a step.
    depth = follower.depth[first[0] : end[0], first[1] : end[1]]
    steps = (
        scipy.ndimage.maximum_filter(depth, 3) - scipy.ndimage.minimum_filter(depth, 3)
        > MOTION.max_step_share * depth
    )
    part[first[0] : end[0], first[1] : end[1]] = scipy.ndimage.binary_closing(
        fits & ((still - followed > chance) | ~steps), np.ones((3, 3))
    )
    groups = scipy.ndimage.label(part)[0]
    own = np.unique(groups[tuple(seeds.T)])
    mask = scipy.ndimage.binary_fill_holes(np.isin(groups, own[own > 0]))
    swept = np.zeros_like(part)
    swept[first[0] : end[0], first[1] : end[1]] = still > MOTION.outlier_ratio * typical
    return mask, swept & ~mask


def _as_at_rest(follower: _Follower, regions: Sequence[_Region]) -> Recording:
    """Replace the frames of parts that move; where they passed by, frames show no fringes."""
    recording, follower = follower.recording, replace(follower, blur_px=0.0)
    frames = [frame.copy() for frame in recording.frames]
    noise, left = np.ones(follower.depth.shape, np.float32), np.zeros(follower.depth.shape, np.float32)
    parts, passed = list[PartMotion](), np.zeros(noise.shape, np.bool_)
    unknown = passed.copy()
    regions = [region.judged for region in regions]
    for region in regions:
        together = _Together.of(follower, region)
        part, ratio = _part_motion(follower, region, together)
        parts.append(part)
        if part.is_compensated:
            noise[region.mask], left[region.mask] = ratio, part.left_px
            passed |= _follow(follower, region, frames, together) | region.swept
            unknown[region.mask] = together is not None and ~together.certain
    # The outermost pixels of a part see what is behind it too, and that does not follow.
    rim = np.ones((2 * MOTION.rim_px + 1, 2 * MOTION.rim_px + 1))
    inner = [scipy.ndimage.binary_erosion(region.mask, rim) for region in regions]
    passed = unknown | passed & ~np.any(inner, axis=0)
    for frame in frames[1:]:
        frame[passed] = frames[0][passed]
    return replace(recording, frames=frames, motion=Compensation(tuple(parts), noise, left))


@dataclass(frozen=True, eq=False)
class _Together:
    """What pixels of a part would show at rest where only all sets together tell it."""

    shown: dict[int, Floats]  # levels (N, P) by set
    noise: Floats  # (P,) of coordinates, over that by even steps
    certain: Mask  # (P,) whose order is

    @classmethod
    def of(cls, follower: _Follower, region: _Region) -> _Together | None:
        """None where sets tell their phases one by one."""
        plan, pixels, moved = follower.recording.plan, np.argwhere(region.mask), region.moved
        used, side = plan.sets_along(plan.axes[0]), MOTION.patch_px
        fits = follower.fits(pixels[:: max(1, len(pixels) // MOTION.trial_pixels)], moved)
        if follower.inverse_depths is None or all(
            np.median(fits[k].noise_ratio) <= MOTION.max_alone_ratio for k in used
        ):
            return None
        patches = _patches(np.unique(pixels // side, axis=0) * side + side // 2, region.mask.shape)
        index = np.zeros(region.mask.shape, np.intp)
        index[tuple(patches.T)] = np.arange(len(patches))
        own = index[tuple(pixels.T)]
        shown, noise, gap = {k: list[Floats]() for k in used}, list[Floats](), list[Floats]()
        for first in range(0, len(patches), MOTION.patches * side**2):
            block = patches[first : first + MOTION.patches * side**2]
            depth, likely = follower.likely(block, moved)
            points, start = follower.rays[tuple(block.T)] * depth[:, None], 0
            for k in used:
                steps = plan.fringes[k].phase_shifts()
                frames = slice(start, start := start + len(steps))
                phase = follower.ways(points, np.zeros(3), k)[2]
                wave = likely.modulation[frames] * np.cos(phase - steps[:, None])
                shown[k].append(likely.offset + wave + beyond_fringe(steps) @ likely.residual[frames])
            noise.append(likely.noise)
            gap.append(likely.gap)
        variance = 4.0 * np.pi * (MOTION.blur_px * follower.noise) ** 2  # of a level that is not blurred
        certain = np.concatenate(gap) > -2.0 * np.log(plan.masks.wrong_order_max) * variance
        levels = {k: np.concatenate(each, axis=1)[:, own] for k, each in shown.items()}
        return cls(levels, np.concatenate(noise)[own], certain[own])


def _follow(follower: _Follower, region: _Region, frames: list[Image], together: _Together | None) -> Mask:
    """Write what frames of the part at rest would show; give the pixels where it was."""
    pixels, plan = np.argwhere(region.mask), follower.recording.plan
    own, top = tuple(pixels.T), full_scale(follower.recording.bits)
    passed = np.zeros(region.mask.shape, np.bool_)
    for k, fit in enumerate(follower.fits(pixels, region.moved)):
        steps = plan.fringes[k].phase_shifts()
        shown = np.stack([np.ones_like(steps), np.cos(steps), np.sin(steps)], axis=1) @ fit.fitted
        shown += beyond_fringe(steps) @ fit.residual
        if together is not None:
            shown = together.shown.get(k, shown)
        first, end = plan.set_starts[k : k + 2]
        for frame, level, at in zip(frames[first:end], shown, fit.places, strict=True):
            frame[own] = np.clip(np.rint(level), 0, top).astype(frame.dtype)
            v, u = np.clip(np.rint(at).astype(int), 0, np.array(passed.shape) - 1).T
            passed[v, u] = True
    passed = scipy.ndimage.binary_dilation(passed, np.ones((3, 3)))  # the lens blurs its edge
    return np.asarray(passed)


def _part_motion(
    follower: _Follower, region: _Region, together: _Together | None = None
) -> tuple[PartMotion, Floats]:
    """What a part did, and how many times greater the noise of its pixels' coordinates gets (P,)."""
    plan, pixels, moved = follower.recording.plan, np.argwhere(region.mask), region.moved
    k = plan.finest_set(plan.axes[0])
    fringe, steps = plan.fringes[k], plan.fringes[k].phase_shifts()
    fit = follower.fits(pixels, moved)[k]
    _, c, s = fit.fitted
    modulation, ratio = np.hypot(c, s), fit.noise_ratio if together is None else together.noise
    phase = np.arctan2(s, c)
    off = np.angle((np.exp(1j * (steps[:, None] - phase)) * np.cos(phase - fit.shifts)).sum(axis=0))
    some = pixels[:: max(1, len(pixels) // MOTION.trial_pixels)]
    ramps = [follower.followed(some, v, k)[1].mean(axis=1) for v in (*(moved + np.eye(3)), moved)]
    by_mm = ramps[3] - np.stack(ramps[:3])  # (3, N) rad
    turned = by_mm @ np.exp(2j * steps) / len(steps)
    left = np.sqrt(0.5 * np.real(turned @ region.covariance @ turned.conj()))
    rate = by_mm[:, -1] - by_mm[:, 0]
    at = follower.shares[plan.set_starts[k] : plan.set_starts[k + 1]]
    size, middle = axis_length(follower.recording.projector_size, fringe.axis), pixels.mean(axis=0)
    to_px = size / fringe.stripes / TWO_PI
    part = PartMotion(
        (float(moved[0]), float(moved[1]), float(moved[2])),
        float(np.sqrt(rate @ region.covariance @ rate) / np.linalg.norm(rate)),
        float(rate @ moved / (at[-1] - at[0])) / TWO_PI,
        (round(middle[1]), round(middle[0])),
        len(pixels),
        to_px * float(np.sqrt(np.mean(off**2))),
        to_px * float(left),
        _is_sound(region, ratio, pixels[modulation * follower.recording.grey >= plan.masks.modulation_min]),
    )
    return part, ratio


def _is_sound(region: _Region, noise_ratio: Floats, lit: Pixels) -> bool:
    """Whether frames allow a compensation; of wrong or very noisy sets orders scatter."""
    if region.measured is None:  # while it is being looked for
        return True
    if np.median(noise_ratio) > MOTION.max_noise_ratio or region.residual_ratio > MOTION.max_rest_ratio:
        return False
    return not len(lit) or bool(region.measured[tuple(lit.T)].mean() >= MOTION.min_points_share)
