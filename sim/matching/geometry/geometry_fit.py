"""Fit of the twin's geometry, by reprojection of the observed points and by the images themselves.

By images: a pixel's level is the reflectance at the point (x, y) of the board that it sees, times the light
of the point (u, v) of the projector's image that illuminates it. The twin gives the derivatives of the level
by these four with the level itself. (Those of a twin that has none are found by finite differences: it is
rendered with board and projector image slightly shifted.) The derivatives of the four by every parameter are
plain geometry (`surface_points`): Gauss-Newton on image residuals, as in image alignment.

Sources: Baker and Matthews, "Lucas-Kanade 20 years on", 2004.; Birge,
"The calculation of errors by the method of least squares", 1932.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import brentq
from scipy.sparse import csr_array

from fpplab.calibration.model import Calibration
from fpplab.characterisation import Characterisation
from fpplab.characterisation.bundle import adjust_bundle, covariance_with_poses
from fpplab.characterisation.parameters import DistortionModel, Model, Solution, vectors_of
from fpplab.characterisation.zhang import matrix_of, transform
from fpplab.core.conventions import Floats, PixelIndices
from fpplab.core.geometry import RigidTransform
from fpplab.core.robust import multiway_covariance
from sim.matching.geometry.board_shape import change_by_bend
from sim.matching.geometry.surface_points import slopes_by_move, surface_and_projector_jacobian
from sim.matching.loss import SURROUNDINGS_PX, board_mask, level_weights, subsample_pixels
from sim.matching.reference import Reference
from sim.matching.samples import TILES, tile_numbers
from sim.parameters import TwinParameters
from sim.twin import ExpectedLevels, Twin


@dataclass(frozen=True)
class GeometryFitLimits:
    """How geometry is fitted to images."""

    shift_mm: float = 0.02  # of the board for finite differences, smaller than any detail of it (numerical)
    shift_px: float = 0.05  # of the projected image for finite differences (numerical)
    linear_px: float = 0.05  # displacement in the camera over which the level of an edge is linear (chosen)
    max_pixels: int = 40_000  # of each pose that are compared (chosen, for speed)
    max_pixels_of_all_poses: int = 400_000  # that are compared (chosen, for memory)


LIMITS = GeometryFitLimits()

NUISANCE_PARAMETERS = 6
"""Parameters of each pose for what light and sharpness still lack: gain (3), offset, response, blur."""


def _shared(calibration: Calibration, free: int) -> Floats:
    pair = vectors_of(calibration.T_projector_camera)
    return np.concatenate(
        [calibration.camera.intrinsics[:free], calibration.projector.intrinsics[:free], pair]
    )


def solution_of(parameters: TwinParameters, board: Floats) -> Solution:
    """Convert the twin's geometry to the form of the bundle adjustment."""
    # board (P, 3) mm
    calibration = parameters.calibration
    return Solution(
        calibration.camera.intrinsics,
        calibration.projector.intrinsics,
        vectors_of(calibration.T_projector_camera),
        np.stack([vectors_of(pose) for pose in parameters.poses]),
        board,
    )


def with_solution(parameters: TwinParameters, solution: Solution) -> TwinParameters:
    """Replace the geometry by the solution of a bundle adjustment."""
    before = parameters.calibration
    calibration = Calibration(
        replace(before.camera, matrix=matrix_of(solution.camera), distortion=solution.camera[4:]),
        replace(before.projector, matrix=matrix_of(solution.projector), distortion=solution.projector[4:]),
        transform(solution.T_projector_camera),
        {},
        before.uncertainty,
    )
    return replace(parameters, calibration=calibration, poses=tuple(transform(p) for p in solution.poses))


def refine_by_reprojection(parameters: TwinParameters, characterisation: Characterisation) -> TwinParameters:
    """Refine the geometry by bundle adjustment of the points observed in camera and projector."""
    model = Model(characterisation.level, characterisation.board)
    start, known = solution_of(parameters, characterisation.board), characterisation.solution
    if known is not None and known.steps.size:  # without its drift, the poses would take it
        start = replace(start, steps=known.steps, ages=known.ages)
    adjusted, _ = adjust_bundle(characterisation.observations, start, model, first=characterisation.sizes)
    return with_solution(parameters, adjusted)


def refine_by_images(reference: Reference, twin: Twin, level: DistortionModel) -> TwinParameters:
    """Make one Gauss-Newton step of the geometry on the residuals of the images."""
    # What light and sharpness still lack must not be taken for motion, so every pose has a gain, linear over
    # the board, an offset, a quadratic term of its response and a blur of its own (`NUISANCE_PARAMETERS`).
    # Each image has a small displacement of the board, normally distributed with the twin's
    # `displacement_mm`.
    start = twin.parameters
    free = len(level.terms)
    shared = 2 * free + 6
    per_pose = 6 + NUISANCE_PARAMETERS
    size = shared + per_pose * len(start.poses)
    normal, gradient = np.zeros((size, size)), np.zeros(size)
    scores = np.zeros((len(start.poses), TILES**2, size))
    for pose in range(len(start.poses)):
        residuals = _residual_of_pose(reference, twin, pose)
        columns = np.append(np.arange(shared), shared + per_pose * pose + np.arange(per_pose))
        displacement, tiles = slice(shared + 3, shared + 6), _tile_members(residuals.pixels)
        for image, jacobian in enumerate(residuals.jacobian(start, free)):
            own, residual = _remove_vibration(reference, twin, residuals, image, jacobian[:, shared + 3 :])
            block, right_side, by_tile = _normal_equations(
                jacobian, residual, displacement, own, start.displacement_mm, tiles
            )
            normal[np.ix_(columns, columns)] += block
            gradient[columns] += right_side
            scores[pose][:, columns] += by_tile
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0] = 1.0
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-12) / np.outer(scale, scale)
    step, covariance = _weighed_with_points(
        inverse @ gradient, covariance_by_tiles(inverse, scores), reference.characterisation, start
    )
    variance = np.diag(covariance)
    of_places = variance[shared:].reshape(-1, per_pose)[:, 3:6].sum(axis=1)
    sigma = {**start.sigma, "poses_um": 1e3 * float(np.sqrt(of_places.mean()))}
    return replace(_parameters_after_step(start, step, free, shared, per_pose), sigma=sigma)


def covariance_by_tiles(inverse: Floats, scores: Floats) -> Floats:
    """Covariance (C, C) of a fit whose residuals depend on each other within a tile of the board."""
    # Scores (P, TILES², C) of one tile depend on each other within a pose, and over all poses, where grain,
    # gloss and bend of the board are in the same place: these move what poses share.
    poses, tiles, parameters = scores.shape
    places = np.tile(np.arange(tiles), poses)
    groupings = [np.arange(len(places)), places]
    return multiway_covariance(inverse, scores.reshape(-1, parameters), groupings)


def _weighed_with_points(
    step: Floats, covariance: Floats, points: Characterisation, start: TwinParameters
) -> tuple[Floats, Floats]:
    """Weigh a step by images (n,) with the geometry by points; the step, and its covariance (n, n)."""
    if points.calibration.uncertainty is None:
        return step, covariance
    free = len(points.level.terms)
    known, now = (_shared(calibration, free) for calibration in (points.calibration, start.calibration))
    to_step, turn = np.eye(len(known)), slice(len(known) - 6, len(known) - 3)
    to_step[turn, turn] = left_jacobian(now[turn])  # a step turns the pose about the axes of the frame
    moves = [to_step @ (known - now)]
    for pose, before in zip(points.poses, start.poses, strict=True):
        moves.append((pose @ before.inverse()).rotation_vector)
        moves.append(pose.translation - before.translation)
        to_step = block_diag(to_step, left_jacobian(pose.rotation_vector), np.eye(3))
    per_pose = (len(step) - len(known)) // len(points.poses)
    places = len(known) + per_pose * np.arange(len(points.poses))[:, None] + np.arange(6)
    return weigh_estimates(
        step,
        covariance,
        np.concatenate(moves),
        to_step @ _covariance_of_points(points) @ to_step.T,
        np.append(np.arange(len(known)), places),
    )


def _covariance_of_points(points: Characterisation) -> Floats:
    """Covariance of devices and poses (n + 6 P, n + 6 P), that of the devices as it is stated."""
    uncertainty, solution = points.calibration.uncertainty, points.solution
    model, sizes = points.model, points.sizes
    assert uncertainty is not None
    assert solution is not None
    assert model is not None
    assert sizes is not None
    joint = covariance_with_poses(points.observations, solution, model, sizes)
    shared = slice(len(uncertainty.covariance))
    follows = joint[:, shared] @ np.linalg.inv(joint[shared, shared])
    return joint + follows @ (uncertainty.covariance - joint[shared, shared]) @ follows.T


def left_jacobian(rotation_vector: Floats) -> Floats:
    """Turn (3, 3) about the axes of the frame by a change of a rotation vector (3,)."""
    angle = float(np.linalg.norm(rotation_vector))
    cross = np.cross(np.eye(3), rotation_vector)
    if angle < 1e-6:
        return np.eye(3) + 0.5 * cross
    by_cross, by_square = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + by_cross * cross + by_square * cross @ cross)


def weigh_estimates(
    step: Floats,
    covariance: Floats,
    known: Floats,
    known_covariance: Floats,
    components: NDArray[np.integer[Any]],
) -> tuple[Floats, Floats]:
    """Combine a step (n,) with other estimates (s,) of some components; also its covariance (n, n)."""
    # Points are centres of marks: blur, grain of the print and uneven light hardly move them, while a fit of
    # images takes for geometry whatever else the twin lacks, and its residuals do not tell. So where the two
    # contradict each other, the covariance of the images is widened until they do not (Birge's ratio).
    count, block = len(known), np.ix_(components, components)
    gap, size = known - step[components], np.sqrt(np.diag(known_covariance))
    own, theirs = (part / np.outer(size, size) for part in (covariance[block], known_covariance))

    def excess(widening: float) -> float:
        return (
            float((gap / size) @ np.linalg.pinv(widening * own + theirs, hermitian=True) @ (gap / size))
            - count
        )

    most = 1.0
    while excess(most) > 0 and most < 1e12:
        most *= 10.0
    widened = covariance * (brentq(excess, most / 10.0, most, rtol=1e-3) if most > 1.0 else 1.0)
    inverse = np.linalg.pinv(widened[block] / np.outer(size, size) + theirs, hermitian=True) / np.outer(
        size, size
    )
    gain = widened[:, components] @ inverse
    return step + gain @ gap, widened - gain @ widened[components]


def _remove_vibration(
    reference: Reference, twin: Twin, residuals: PoseResidual, image: int, jacobian: Floats
) -> tuple[Floats, Floats]:
    """Estimate the board's displacement (3,) in mm in one image, and the residuals (P,) without it."""
    # jacobian: (P, 3 + NUISANCE_PARAMETERS), by the displacement and the nuisance parameters. The level of an
    # edge is not linear over a great displacement: the twin is then rendered again with the board displaced.
    start, residual = twin.parameters, residuals.residual[image]
    if start.displacement_mm == 0:
        return np.zeros(3), residual
    own = np.linalg.solve(jacobian.T @ jacobian, jacobian.T @ residual)[:3]
    pose, camera = start.poses[residuals.pose], start.calibration.camera
    if np.linalg.norm(own) * camera.matrix[0, 0] < LIMITS.linear_px * pose.translation[2]:
        return own, residual - jacobian[:, :3] @ own
    moved = twin.with_parameters(start.with_pose(residuals.pose, pose.moved(own)))
    pattern = reference.shown([residuals.images[image]])
    level = moved.expected_at(residuals.pose, pattern, reference.settings, residuals.pixels)[0].astype(
        np.float64
    )
    return own, residual - np.where(residuals.valid[image], level - residuals.expected[image], 0.0)


def _normal_equations(
    jacobian: Floats,
    residual: Floats,
    displacement: slice,
    own: Floats,
    vibration_mm: float,
    tiles: csr_array,
) -> tuple[Floats, Floats, Floats]:
    """Build normal equations (C, C), (C,) of an image, weighted by its noise, displacement eliminated."""
    # displacement: columns of the board's displacement. That of the image is normally distributed with
    # `vibration_mm`; the residual is without its estimate `own`. tiles: (T, P), which pixels each has. At
    # last the part of each tile in the right side, (T, C).
    weight, sigma = level_weights(residual)
    weighted = jacobian * (weight / sigma**2)[:, None]
    block = jacobian.T @ weighted
    scores: Floats = tiles @ (weighted * residual[:, None])
    if vibration_mm == 0:
        return block, scores.sum(axis=0), scores
    normal = block[displacement, displacement] + np.eye(3) / vibration_mm**2
    share = np.linalg.solve(normal, block[displacement])
    scores = scores - scores[:, displacement] @ share
    right_side = scores.sum(axis=0) + share.T @ own / vibration_mm**2
    return block - block[:, displacement] @ share, right_side, scores


def _tile_members(pixels: PixelIndices) -> csr_array:
    """Return which pixels each tile has: (T, P), 1 where it has one."""
    tiles = tile_numbers(pixels)
    number = np.arange(len(tiles))
    return csr_array((np.ones(len(tiles)), (tiles, number)), shape=(TILES**2, len(tiles)))


def _parameters_after_step(
    start: TwinParameters, step: Floats, free: int, shared: int, per_pose: int
) -> TwinParameters:
    now = solution_of(start, np.zeros((0, 3)))
    camera, projector = now.camera.copy(), now.projector.copy()
    camera[:free] += step[:free]
    projector[:free] += step[free : 2 * free]
    moves = step[shared:].reshape(-1, per_pose)[:, :6]
    poses = np.stack([_perturb_pose(pose, move) for pose, move in zip(now.poses, moves, strict=True)])
    pair = _perturb_pose(now.T_projector_camera, step[2 * free : shared])
    return with_solution(start, Solution(camera, projector, pair, poses, now.board))


def _perturb_pose(pose: Floats, move: Floats) -> Floats:
    """Turn a pose (6,) by a small rotation about the device's axes, and move it."""
    turn = RigidTransform.from_vectors(move[:3], np.zeros(3)).rotation
    held = transform(pose)
    return vectors_of(RigidTransform(turn @ held.rotation, held.translation + move[3:]))


@dataclass(frozen=True, eq=False)
class PoseResidual:
    """Residuals of some pixels in some images of one pose."""

    pose: int  # index of the pose
    images: tuple[int, ...]  # indices of the n images in the plan
    pixels: PixelIndices  # rows and columns of the P pixels
    valid: NDArray[np.bool_]  # (n, P), neither saturated nor dark
    expected: Floats  # raw levels (n, P) that the twin expects
    residual: Floats  # reference less twin, bent as the reference's board is, (n, P) in raw levels
    laplacian: Floats  # of the expected image, (n, P): proportional to the effect of slightly more blur
    level_gradient: Floats  # (n, P, 4) mm

    def jacobian(self, at: TwinParameters, free: int) -> Iterator[Floats]:
        """Compute the derivatives of the levels by the parameters of `refine_by_images`."""
        # returns (P, C)
        points = np.stack(self.pixels[::-1], axis=-1).astype(np.float64)
        places = surface_and_projector_jacobian(points, at.calibration, at.poses[self.pose], free)
        across, down = ((points - points.mean(axis=0)) / np.ptp(points, axis=0)).T
        for levels, laplacian, level_gradient in zip(
            self.expected, self.laplacian, self.level_gradient, strict=True
        ):
            geometric = np.einsum("pk,pkc->pc", level_gradient, places)
            other = [levels, levels * across, levels * down, np.ones_like(levels), levels**2, laplacian]
            yield np.column_stack([geometric, *other])


def _residual_of_pose(reference: Reference, twin: Twin, pose: int) -> PoseResidual:
    start, images = twin.parameters, reference.finest_spread
    looked_at = board_mask(start.calibration.camera, start.poses[pose], reference.target, -SURROUNDINGS_PX)
    pixels = subsample_pixels(
        looked_at, min(LIMITS.max_pixels, LIMITS.max_pixels_of_all_poses // len(start.poses))
    )
    recorded, patterns = reference.frames(pose, images)[:, *pixels], reference.shown(images)

    def picked(levels: ExpectedLevels) -> Floats:
        return np.asarray(levels[:, *pixels], np.float64)

    whole = twin.expected(pose, patterns, reference.settings)
    here = picked(whole)
    even = reference.evened(whole, start.black_level)
    laplacian = picked(np.stack([cv2.Laplacian(image, cv2.CV_32F) for image in even]))
    _, gradient = levels_with_gradient(reference, twin, pose, images, pixels)
    slopes = slopes_by_move(pixels, start.calibration, start.poses[pose], gradient)
    bent = change_by_bend(reference, start, pose, pixels, slopes)
    # Where there is no light there is no noise either, and rounding errors are all the same.
    dark = start.black_level * reference.full_scale + 1.0
    valid = (recorded < reference.full_scale) & (here < reference.full_scale) & (here > dark)
    return PoseResidual(
        pose,
        tuple(images),
        pixels,
        valid,
        here,
        np.where(valid, recorded - here - bent, 0.0),
        laplacian * valid,
        gradient * valid[..., None],
    )


def levels_with_gradient(
    reference: Reference, twin: Twin, pose: int, images: Sequence[int], pixels: PixelIndices
) -> tuple[Floats, Floats]:
    """Compute levels, and differentiate them by the places on board and projector that pixels see."""
    # returns levels (n, P), gradient (n, P, 4) mm
    patterns = reference.shown(images)
    own = twin.expected_with_slopes(pose, patterns, reference.settings, pixels)
    if own is not None:
        return own[0].astype(np.float64), own[1].astype(np.float64)

    def seen_by(of: Twin) -> Floats:
        return of.expected_at(pose, patterns, reference.settings, pixels).astype(np.float64)

    here = seen_by(twin)
    gradient = [
        sign * (seen_by(twin.with_parameters(moved)) - here) / by
        for moved, by, sign in _board_and_projector_shifts(twin.parameters, pose)
    ]
    return here, np.stack(gradient, axis=-1)


def _board_and_projector_shifts(
    start: TwinParameters, pose: int
) -> list[tuple[TwinParameters, float, float]]:
    """Shift the board in its plane, and the projector's image, along each axis."""
    # With each, how far, and the sign with which the point seen moves.
    held = start.poses[pose]
    shifted = []
    for axis in range(2):
        moved_board = held.moved(LIMITS.shift_mm * held.rotation[:, axis])
        shifted.append((start.with_pose(pose, moved_board), LIMITS.shift_mm, -1.0))
    for axis in range(2):
        calibration = start.calibration
        matrix = calibration.projector.matrix.copy()
        matrix[axis, 2] += LIMITS.shift_px
        moved = replace(calibration, projector=replace(calibration.projector, matrix=matrix))
        shifted.append((replace(start, calibration=moved), LIMITS.shift_px, 1.0))
    return shifted
