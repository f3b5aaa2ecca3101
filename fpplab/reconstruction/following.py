"""Pixels of a part, followed through the frames of a scan along a displacement.

The displacement is one vector for all pixels of a part, in mm from the first frame to the last; what is
fitted to the followed levels is given for the middle of the finest set.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
import scipy  # whose parts are loaded where something moves
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import AXES, TWO_PI, Floats, Map, Mask, axis_length
from fpplab.patterns.recording import Recording
from fpplab.patterns.unwrapping import unwrapping_methods
from fpplab.phase.limits import COMMON_ERRORS, MOTION
from fpplab.reconstruction.likely_depths import LikelyDepths, likely_depths
from fpplab.reconstruction.triangulation import camera_rays

Pixels = NDArray[np.intp]  # (P, 2) row and column


def shares_of_scan(recording: Recording) -> Floats:
    """When each frame was taken, as a share of the time from the first to the last, less the middle set's."""
    plan, count = recording.plan, recording.plan.images
    times = np.array(recording.times_s if len(recording.times_s) == count else range(count), np.float64)
    finest = plan.finest_set(plan.axes[0])
    middle = times[plan.set_starts[finest] : plan.set_starts[finest + 1]].mean()
    return np.asarray((times - middle) / max(times[-1] - times[0], 1e-12))


@dataclass(frozen=True, eq=False)
class Follower:
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
        return shares_of_scan(self.recording)

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
        places = offsets + pixels
        levels = [
            scipy.ndimage.map_coordinates(spline, at.T, prefilter=False, mode="nearest", output=np.float64)
            for spline, at in zip(self.splines[first:end], places, strict=True)
        ]
        return np.stack(levels), shifts, np.asarray(places)

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

    def at_depth(self, depth: Floats) -> Follower:
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

    def likely_by_blocks(
        self, patches: Pixels, moved: Floats
    ) -> Iterator[tuple[Pixels, Floats, LikelyDepths]]:
        """Go through pixels of patches by as many as memory allows: pixels, depths, and what fits there."""
        size = MOTION.patches * MOTION.patch_px**2
        for first in range(0, len(patches), size):
            block = patches[first : first + size]
            yield block, *self.likely(block, moved)

    def with_likely_depths(self, pixels: Pixels, moved: Floats) -> Follower:
        """The same with the likeliest depths of patches about the pixels, and of those nearest to others."""
        depth = self.depth.copy()
        centres = np.random.default_rng(0).permutation(centres_of_patches(pixels))[: MOTION.max_patches]
        patches = patches_about(centres, depth.shape)
        for block, likely_mm, _ in self.likely_by_blocks(patches, moved):
            depth[tuple(block.T)] = likely_mm
        unknown = np.ones(depth.shape, np.bool_)
        unknown[tuple(patches.T)] = False
        if unknown[own := tuple(pixels.T)].any():
            nearest = scipy.ndimage.distance_transform_edt(
                unknown, return_distances=False, return_indices=True
            )
            depth[own] = depth[tuple(nearest[(slice(None), *own)])]
        return self.at_depth(depth)

    @cached_property
    def compared(self) -> list[int]:
        """Sets whose offset is the same but for the lamp's gain, none where there is only one."""
        fringes = self.recording.plan.fringes
        fine = [k for k, fringe in enumerate(fringes) if fringe.stripes >= COMMON_ERRORS.min_stripes]
        return fine if len(fine) > 1 else []

    def fits(self, pixels: Pixels, moved: Floats, *, gains: bool = True) -> list[FollowedFit]:
        """Fit every set at the pixels; sets of one offset together, which uneven steps alone may not tell."""
        fits = [fit_set(*self.followed(pixels, moved, k)) for k in range(len(self.recording.plan.fringes))]
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

    def _gain(self, fit: FollowedFit, offset: Floats) -> float:
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


@dataclass(frozen=True, eq=False)
class FollowedFit:
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

    def with_offset(self, offset: Floats, variance: Floats) -> FollowedFit:
        """The same where the offset is known from all sets."""
        along = self.inverse[:, :, 0] / self.inverse[:, :1, 0]
        fitted = self.fitted + along.T * (offset - self.fitted[0])
        known = (self.inverse[:, 0, 0] - variance)[:, None, None]
        return replace(
            self, fitted=fitted, inverse=self.inverse - known * along[:, :, None] * along[:, None, :]
        )


def fit_set(levels: Floats, shifts: Floats, places: Floats) -> FollowedFit:
    waves = np.stack([np.ones_like(shifts), np.cos(shifts), np.sin(shifts)])
    normal = np.einsum("inp,jnp->pij", waves, waves) + 1e-6 * np.eye(3)
    inverse = np.linalg.inv(normal)
    fitted = np.einsum("pij,jnp,np->ip", inverse, waves, levels, optimize=True)
    return FollowedFit(levels, shifts, places, fitted, inverse)


def _without_gains(residual: Floats, levels: Floats) -> Floats:
    """Take off what each frame shows brighter than others at all pixels."""
    gains = np.sum(residual * levels, axis=1) / np.sum(levels**2, axis=1)
    return np.asarray(residual - gains[:, None] * levels)


def centres_of_patches(pixels: Pixels) -> Pixels:
    """Centres of the patches of a grid in which pixels lie."""
    side = MOTION.patch_px
    return np.asarray(np.unique(pixels // side, axis=0) * side + side // 2)


def patches_about(centres: Pixels, shape: tuple[int, ...]) -> Pixels:
    """The pixels of squares about some, those of a square one after another."""
    half = MOTION.patch_px // 2
    around = np.stack(np.meshgrid(*2 * [np.arange(-half, half + 1)], indexing="ij"), axis=-1).reshape(-1, 2)
    inside = np.clip(centres, half, np.array(shape) - half - 1)
    return np.asarray((inside[:, None] + around).reshape(-1, 2))


def fit_displacement(follower: Follower, start: Floats, pixels: Pixels) -> tuple[Floats, Floats]:
    """The displacement that costs least, and its covariance."""
    # Least squares take slopes of the noise between pixels for those of the picture and slow down, so that
    # Newton's method comes last.
    moved, step = _by_least_squares(follower, start, pixels), MOTION.derivative_mm
    for _ in range(MOTION.newton_steps):
        here = displacement_cost(follower, moved, pixels)
        ahead, behind = (
            np.array([displacement_cost(follower, moved + s * e, pixels) for e in np.eye(3)])
            for s in (step, -step)
        )
        bent = np.diag(ahead + behind - 2.0 * here)
        for i, j in combinations(range(3), 2):
            both = displacement_cost(follower, moved + step * (np.eye(3)[i] + np.eye(3)[j]), pixels)
            bent[i, j] = bent[j, i] = both - ahead[i] - ahead[j] + here
        strength, directions = np.linalg.eigh(bent / step**2)
        inverse = (directions / np.maximum(np.abs(strength), MOTION.prior_mm**-2)) @ directions.T
        change = -inverse @ (ahead - behind) / (2.0 * step)
        change *= min(1.0, MOTION.max_step_mm / float(np.linalg.norm(change)))
        moved = moved + change
        if np.linalg.norm(change) < MOTION.tolerance_mm:
            break
    return moved, inverse


def _by_least_squares(follower: Follower, start: Floats, pixels: Pixels) -> Floats:
    """Near the displacement that costs least, also from far away."""

    def values(moved: Floats) -> Floats:
        return np.asarray(np.append(follower.residuals(pixels, moved).ravel(), moved / MOTION.prior_mm))

    def slopes(moved: Floats) -> Floats:
        here, step = values(moved), MOTION.derivative_mm
        return np.asarray(np.stack([values(moved + step * e) - here for e in np.eye(3)], axis=1) / step)

    tolerance = MOTION.fit_tolerance
    fit = scipy.optimize.least_squares(
        values,
        start,
        slopes,
        loss="soft_l1",
        f_scale=MOTION.outlier_sigmas,
        ftol=tolerance,
        xtol=tolerance,
        max_nfev=MOTION.fit_passes,
    )
    return np.asarray(fit.x)


def displacement_cost(follower: Follower, moved: Floats, pixels: Pixels) -> float:
    """Half of what remains, in squares of its noise; outliers count by their size."""
    expected = 0.5 * np.square(moved / MOTION.prior_mm).sum()
    return _robust(follower.residuals(pixels, moved)) + float(expected)


def _robust(residuals: Floats) -> float:
    squares = np.sqrt(1.0 + np.square(residuals / MOTION.outlier_sigmas)) - 1.0
    return float(MOTION.outlier_sigmas**2 * squares.sum())


def runs_forward(follower: Follower, moved: Floats, pixels: Pixels) -> bool:
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


def is_even_motion(follower: Follower, moved: Floats, pixels: Pixels) -> bool:
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


def pixels_that_follow(follower: Follower, seeds: Pixels, moved: Floats, window_px: int) -> tuple[Mask, Mask]:
    """Which pixels follow a displacement and hang together, and which neither follow nor stand still."""
    part = np.zeros(follower.depth.shape, np.bool_)
    first = np.maximum(seeds.min(axis=0) - MOTION.margin_px, 0)
    end = np.minimum(seeds.max(axis=0) + MOTION.margin_px + 1, part.shape)
    nearby = np.stack(np.meshgrid(*(np.arange(a, b) for a, b in zip(first, end, strict=True)), indexing="ij"))
    blocks = np.array_split(nearby.reshape(2, -1).T, nearby[0].size // MOTION.block_pixels + 1)

    def remaining_power(displacement: Floats) -> Floats:
        power = [np.square(follower.residuals(b, displacement, gains=False)).sum(axis=0) for b in blocks]
        return np.asarray(
            scipy.ndimage.uniform_filter(np.concatenate(power).reshape(nearby[0].shape), window_px)
        )

    chance = MOTION.chance_sigmas * np.sqrt(2.0 * follower.freedom) / window_px
    still, followed = remaining_power(np.zeros(3)), remaining_power(moved)
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
