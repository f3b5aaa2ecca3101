"""Parts that move evenly while they are scanned: their frames as if they had stood still.

A part that moves shows each frame of a fringe set at another phase. A sinusoid then leaves a residual of its
frames, which vanishes where they are followed along the right displacement and fitted at the phases at which
they were taken. The displacement is one vector for all pixels of a part; the residuals of still and of
followed pixels tell the part from what stands still. Everything is given for the middle of the finest set.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # whose parts are loaded where something moves

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import TWO_PI, Floats, Image, Mask, axis_length, full_scale
from fpplab.core.errors import FppError
from fpplab.patterns.motion import Compensation, PartMotion
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.phase.common_errors import beyond_fringe
from fpplab.phase.limits import MOTION
from fpplab.reconstruction.depth_range import decoding_bounds
from fpplab.reconstruction.following import Follower, Pixels, centres_of_patches, patches_about
from fpplab.reconstruction.moving_parts import MovingPart, MovingTiles, find_moving_parts, refitted
from fpplab.reconstruction.points import triangulate


def compensate_motion(recording: Recording, calibration: Calibration) -> Recording:
    """Give the frames of parts that move as those of parts at rest; the same recording where none does."""
    plan = recording.plan
    if recording.merged or recording.bayer or plan.fringe_part is not plan or recording.motion:
        return recording
    tiles = MovingTiles.of(recording)
    depth = None if tiles is None else _depth(recording, calibration, rough=True)
    if tiles is None or depth is None:
        return recording
    noise = np.sqrt(tiles.variance / (4.0 * np.pi)) / MOTION.blur_px
    follower = Follower(recording, calibration, depth[0], float(noise))
    regions = find_moving_parts(follower, tiles)
    if not regions:
        return recording
    for _ in range(MOTION.passes):
        depth, before = _depth(_as_at_rest(follower, regions), calibration, rough=False), regions
        if depth is None:
            break
        follower = follower.at_depth(depth[0])
        regions = [refitted(follower, region) for region in regions]
        changes = [np.abs(a.moved - b.moved).max() for a, b in zip(before, regions, strict=True)]
        if max(changes) < MOTION.tolerance_mm:
            break
    depth = _depth(_as_at_rest(follower, regions), calibration, rough=False)
    measured = np.zeros(follower.depth.shape, np.bool_) if depth is None else depth[1]
    return _as_at_rest(follower, [replace(each, measured=measured & each.is_followed) for each in regions])


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


def _as_at_rest(follower: Follower, regions: Sequence[MovingPart]) -> Recording:
    """Replace the frames of parts that move; where they passed by, frames show no fringes."""
    recording, follower = follower.recording, replace(follower, blur_px=0.0)
    frames = [frame.copy() for frame in recording.frames]
    noise = np.ones(follower.depth.shape, np.float32)
    remaining_px = np.zeros_like(noise)
    parts, passed = list[PartMotion](), np.zeros(noise.shape, np.bool_)
    unknown = passed.copy()
    regions = [region.judged for region in regions]
    for region in regions:
        together = _Together.of(follower, region)
        part, ratio = _part_motion(follower, region, together)
        parts.append(part)
        if part.is_compensated:
            noise[region.mask], remaining_px[region.mask] = ratio, part.left_px
            passed |= _follow(follower, region, frames, together) | region.swept
            unknown[region.mask] = together is not None and ~together.certain
    # The outermost pixels of a part see what is behind it too, and that does not follow.
    rim = np.ones((2 * MOTION.rim_px + 1, 2 * MOTION.rim_px + 1))
    inner = [scipy.ndimage.binary_erosion(region.mask, rim) for region in regions]
    passed = unknown | passed & ~np.any(inner, axis=0)
    for frame in frames[1:]:
        frame[passed] = frames[0][passed]
    return replace(recording, frames=frames, motion=Compensation(tuple(parts), noise, remaining_px))


@dataclass(frozen=True, eq=False)
class _Together:
    """What pixels of a part would show at rest where only all sets together tell it."""

    shown: dict[int, Floats]  # levels (N, P) by set
    noise: Floats  # (P,) of coordinates, over that by even steps
    certain: Mask  # (P,) whose order is

    @classmethod
    def of(cls, follower: Follower, region: MovingPart) -> _Together | None:
        """None where sets tell their phases one by one."""
        plan, pixels, moved = follower.recording.plan, np.argwhere(region.mask), region.moved
        used = plan.sets_along(plan.axes[0])
        fits = follower.fits(pixels[:: max(1, len(pixels) // MOTION.trial_pixels)], moved)
        if follower.inverse_depths is None or all(
            np.median(fits[k].noise_ratio) <= MOTION.max_alone_ratio for k in used
        ):
            return None
        patches = patches_about(centres_of_patches(pixels), region.mask.shape)
        index = np.zeros(region.mask.shape, np.intp)
        index[tuple(patches.T)] = np.arange(len(patches))
        own = index[tuple(pixels.T)]
        shown, noise, gap = {k: list[Floats]() for k in used}, list[Floats](), list[Floats]()
        for block, depth, likely in follower.likely_by_blocks(patches, moved):
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


def _follow(follower: Follower, region: MovingPart, frames: list[Image], together: _Together | None) -> Mask:
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
    follower: Follower, region: MovingPart, together: _Together | None = None
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
    remaining_rad = np.sqrt(0.5 * np.real(turned @ region.covariance @ turned.conj()))
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
        to_px * float(remaining_rad),
        _is_sound(region, ratio, pixels[modulation * follower.recording.grey >= plan.masks.modulation_min]),
    )
    return part, ratio


def _is_sound(region: MovingPart, noise_ratio: Floats, lit: Pixels) -> bool:
    """Whether frames allow a compensation; of wrong or very noisy sets orders scatter."""
    if region.measured is None:  # while it is being looked for
        return True
    if np.median(noise_ratio) > MOTION.max_noise_ratio or region.residual_ratio > MOTION.max_rest_ratio:
        return False
    return not len(lit) or bool(region.measured[tuple(lit.T)].mean() >= MOTION.min_points_share)
