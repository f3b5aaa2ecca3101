"""Where everything stands: by the points that were observed, and by the images themselves.

By images: a pixel's level is what is printed at the place (x, y) of the board that it looks at, times the
light at the place (u, v) of the projector's picture that falls there. How the level changes with these four
is asked of the twin, by moving board and picture a little; how they change with every parameter is plain
geometry. So five pictures of a pose give the slopes by all parameters: Gauss-Newton on image residuals, as in
image alignment (Baker and Matthews, "Lucas-Kanade 20 years on", 2004).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import INTRINSICS, Calibration
from fpplab.characterisation import Characterisation
from fpplab.characterisation.bundle import DistortionModel, Model, Solution, adjust_bundle, vectors_of
from fpplab.characterisation.zhang import matrix_of, transform
from fpplab.core.conventions import Floats, PixelIndices
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.matching.loss import BEYOND_PX, board_mask, soft_weights, thinned
from fpplab.matching.reference import Reference
from fpplab.simulation.matchable import ExpectedLevels, Parameters, Twin

SHIFT_MM, SHIFT_PX = 0.02, 0.05
"""By how much board and projector's picture are moved to see what changes: less than any detail of either."""
PIXELS = 40_000
"""Of a pose that are looked at: evenly thinned to so many."""
STEPS = {"fx": 0.1, "fy": 0.1, "cx": 0.1, "cy": 0.1} | dict.fromkeys(INTRINSICS[4:], 1e-5)
TURN_RAD, MOVE_MM = 1e-6, 1e-3
NUISANCES = 6


def solution_of(parameters: Parameters, board: Floats) -> Solution:
    """The geometry as the bundle adjustment has it. board: (P, 3) in mm."""
    known = parameters.calibration
    return Solution(
        _intrinsics(known.camera),
        _intrinsics(known.projector),
        vectors_of(known.T_projector_camera),
        np.stack([vectors_of(pose) for pose in parameters.poses]),
        board,
    )


def with_solution(parameters: Parameters, found: Solution) -> Parameters:
    """The parameters with another geometry; what was known of the old one's uncertainty is dropped."""
    known = parameters.calibration
    calibration = Calibration(
        replace(known.camera, matrix=matrix_of(found.camera), distortion=found.camera[4:]),
        replace(known.projector, matrix=matrix_of(found.projector), distortion=found.projector[4:]),
        transform(found.T_projector_camera),
        {},
    )
    return replace(parameters, calibration=calibration, poses=tuple(transform(p) for p in found.poses))


def _intrinsics(device: Pinhole) -> Floats:
    k = device.matrix
    return np.array([k[0, 0], k[1, 1], k[0, 2], k[1, 2], *device.distortion])


def by_reprojection(parameters: Parameters, found: Characterisation) -> Parameters:
    """The geometry nearest to `parameters` that explains the observed points best, in both devices.

    Raises `CalibrationError` when there is none.
    """
    model = Model(found.level, found.board)
    return with_solution(
        parameters, adjust_bundle(found.observations, solution_of(parameters, found.board), model)
    )


def by_images(bench: Reference, twin: Twin, level: DistortionModel) -> Parameters:
    """The twin's parameters after one Gauss-Newton step of the geometry on the images' residuals.

    level: which terms of the distortion are free. What light and sharpness still lack must not be taken for
    motion, so every pose has a gain, linear over the board, an offset, a bend of its response and a blur of
    its own besides (`NUISANCES`). Each image has the board displaced a little, as far as it vibrates.
    """
    start = twin.parameters
    free = len(level.terms)
    shared = 2 * free + 6
    each = 6 + NUISANCES
    size = shared + each * len(start.poses)
    normal, gradient = np.zeros((size, size)), np.zeros(size)
    for pose in range(len(start.poses)):
        view = _look(bench, twin, start, pose)
        columns = np.append(np.arange(shared), shared + each * pose + np.arange(each))
        moves = slice(shared + 3, shared + 6)
        for image, slopes in enumerate(view.slopes(start, free)):
            own, residual = _shaken(bench, twin, start, view, image, slopes[:, shared + 3 :])
            block, pull = _equations(slopes, residual, moves, own, start.vibration_mm)
            normal[np.ix_(columns, columns)] += block
            gradient[columns] += pull
    twin.become(start)
    scale = np.sqrt(np.diag(normal))
    scale[scale == 0] = 1.0
    step = np.linalg.lstsq(normal / np.outer(scale, scale), gradient / scale, rcond=1e-12)[0] / scale
    return _moved(start, step, free, shared, each)


def _shaken(
    bench: Reference, twin: Twin, start: Parameters, view: PoseResidual, image: int, slopes: Floats
) -> tuple[Floats, Floats]:
    """By how much the board was displaced (3,) in mm while one image was taken, and what that leaves (P,).

    slopes: (P, 3 + NUISANCES), by the displacement and what else is the image's own. An edge's level is
    no straight line over the displacement, so the twin is looked at once more where the board was.
    """
    residual = view.residual[image]
    if start.vibration_mm == 0:
        return np.zeros(3), residual
    own = np.linalg.solve(slopes.T @ slopes, slopes.T @ residual)[:3]
    twin.become(start.with_pose(view.pose, start.poses[view.pose].moved(own)))
    pattern = bench.shown([view.images[image]])
    level = twin.expected_at(view.pose, pattern, bench.settings, view.pixels)[0].astype(np.float64)
    return own, residual - np.where(view.clear[image], level - view.expected[image], 0.0)


def _equations(
    slopes: Floats, residual: Floats, moves: slice, own: Floats, vibration_mm: float
) -> tuple[Floats, Floats]:
    """Normal equations (C, C), (C,) of one image, in units of its noise, its own displacement eliminated.

    moves: which columns are the board's displacement; the image's own is normal with `vibration_mm`, and
    `own` of it is in the residual already.
    """
    weight, sigma = soft_weights(residual)
    weighted = slopes * (weight / sigma**2)[:, None]
    block, pull = slopes.T @ weighted, weighted.T @ residual
    if vibration_mm == 0:
        return block, pull
    normal = block[moves, moves] + np.eye(3) / vibration_mm**2
    share = np.linalg.solve(normal, block[moves])
    return block - block[:, moves] @ share, pull - share.T @ (pull[moves] - own / vibration_mm**2)


def _moved(start: Parameters, step: Floats, free: int, shared: int, each: int) -> Parameters:
    now = solution_of(start, np.zeros((0, 3)))
    camera, projector = now.camera.copy(), now.projector.copy()
    camera[:free] += step[:free]
    projector[:free] += step[free : 2 * free]
    moves = step[shared:].reshape(-1, each)[:, :6]
    poses = np.stack([_turned(pose, move) for pose, move in zip(now.poses, moves, strict=True)])
    pair = _turned(now.T_projector_camera, step[2 * free : shared])
    return with_solution(start, Solution(camera, projector, pair, poses, now.board))


def _turned(pose: Floats, move: Floats) -> Floats:
    """A pose (6,) turned by a small rotation about the device's axes, and moved."""
    turn = RigidTransform.from_vectors(move[:3], np.zeros(3)).rotation
    held = transform(pose)
    return vectors_of(RigidTransform(turn @ held.rotation, held.translation + move[3:]))


@dataclass(frozen=True, eq=False)
class PoseResidual:
    """Some pixels of some images of one pose.

    expected, residual: (n, P), what the twin sees and the bench less that, where the levels are `clear`.
    bent: (n, P), the Laplacian of what the twin sees, to which a bit more blur is proportional.
    by_place: (n, P, 4), how the level changes with x, y on the board in mm and u, v of the projector in px.
    """

    pose: int
    images: tuple[int, ...]
    pixels: PixelIndices
    clear: NDArray[np.bool_]
    expected: Floats
    residual: Floats
    bent: Floats
    by_place: Floats

    def slopes(self, at: Parameters, free: int) -> Iterator[Floats]:
        """Of each image, slopes (P, C) by the parameters of `by_images`."""
        points = np.stack(self.pixels[::-1], axis=-1).astype(np.float64)
        places = _places(points, at.calibration, at.poses[self.pose], free)
        across, down = ((points - points.mean(axis=0)) / np.ptp(points, axis=0)).T
        for seen, bent, by_place in zip(self.expected, self.bent, self.by_place, strict=True):
            geometric = np.einsum("pk,pkc->pc", by_place, places)
            other = [seen, seen * across, seen * down, np.ones_like(seen), seen**2, bent]
            yield np.column_stack([geometric, *other])


def _look(bench: Reference, twin: Twin, start: Parameters, pose: int) -> PoseResidual:
    images = bench.finest_spread
    looked_at = board_mask(start.calibration.camera, start.poses[pose], bench.target, -BEYOND_PX)
    pixels = thinned(looked_at, PIXELS)
    seen, patterns = bench.frames(pose, images)[:, *pixels], bench.shown(images)

    def picked(levels: ExpectedLevels) -> Floats:
        return np.asarray(levels[:, *pixels], np.float64)

    def seen_from(there: Parameters) -> Floats:
        twin.become(there)
        return twin.expected_at(pose, patterns, bench.settings, pixels).astype(np.float64)

    twin.become(start)
    whole = twin.expected(pose, patterns, bench.settings)
    here = picked(whole)
    bent = picked(np.stack([cv2.Laplacian(one, cv2.CV_32F) for one in whole]))
    slopes = [(sign * (seen_from(there) - here) / by) for there, by, sign in _shifted(start, pose)]
    # Where there is no light there is no noise either, and rounding errors are all the same.
    dark = start.black_level * bench.full_scale + 1.0
    clear = (seen < bench.full_scale) & (here < bench.full_scale) & (here > dark)
    return PoseResidual(
        pose,
        tuple(images),
        pixels,
        clear,
        here,
        np.where(clear, seen - here, 0.0),
        bent * clear,
        np.stack(slopes, axis=-1) * clear[..., None],
    )


def _shifted(start: Parameters, pose: int) -> list[tuple[Parameters, float, float]]:
    """The twin with the board shifted in its plane, and with the projector's picture shifted.

    With each, how far, and the sign with which the place looked at moves.
    """
    held = start.poses[pose]
    found = []
    for axis in range(2):
        there = held.moved(SHIFT_MM * held.rotation[:, axis])
        found.append((start.with_pose(pose, there), SHIFT_MM, -1.0))
    for axis in range(2):
        known = start.calibration
        matrix = known.projector.matrix.copy()
        matrix[axis, 2] += SHIFT_PX
        moved = replace(known, projector=replace(known.projector, matrix=matrix))
        found.append((replace(start, calibration=moved), SHIFT_PX, 1.0))
    return found


def _places(pixels: Floats, known: Calibration, pose: RigidTransform, free: int) -> Floats:
    """How the places that pixels look at, (x, y, u, v), change with every parameter, (P, 4, C)."""
    camera, projector, pair = known.camera, known.projector, known.T_projector_camera
    slopes = camera.normalise(pixels)
    here = _place(slopes, projector, pair, pose)

    def change(there: Floats, step: float) -> Floats:
        return (there - here) / step

    columns = []
    for term in INTRINSICS[:free]:
        seen = _other(camera, term).normalise(pixels)
        columns.append(change(_place(seen, projector, pair, pose), STEPS[term]))
    for term in INTRINSICS[:free]:
        columns.append(change(_place(slopes, _other(projector, term), pair, pose), STEPS[term]))
    for move, step in _small_moves():
        columns.append(
            change(_place(slopes, projector, transform(_turned(vectors_of(pair), move)), pose), step)
        )
    for move, step in _small_moves():
        columns.append(
            change(_place(slopes, projector, pair, transform(_turned(vectors_of(pose), move))), step)
        )
    return np.stack(columns, axis=-1)


def _small_moves() -> list[tuple[Floats, float]]:
    steps = [TURN_RAD] * 3 + [MOVE_MM] * 3
    return [(step * row, step) for step, row in zip(steps, np.eye(6), strict=True)]


def _other(device: Pinhole, term: str) -> Pinhole:
    intrinsics = _intrinsics(device)
    intrinsics[INTRINSICS.index(term)] += STEPS[term]
    return replace(device, matrix=matrix_of(intrinsics), distortion=intrinsics[4:])


def _place(slopes: Floats, projector: Pinhole, pair: RigidTransform, pose: RigidTransform) -> Floats:
    """Where rays of the camera (P, 2) meet the board, and where the projector lights that: (P, 4)."""
    rays = np.concatenate([slopes, np.ones((len(slopes), 1))], axis=-1)
    normal = pose.rotation[:, 2]
    points = rays * ((normal @ pose.translation) / (rays @ normal))[:, None]
    on_board = pose.inverse().apply(points)
    return np.concatenate([on_board[:, :2], projector.project(points, pair)], axis=-1)
