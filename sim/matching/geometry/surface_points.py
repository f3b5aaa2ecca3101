"""The places that a pixel sees, and their derivatives by every parameter of the geometry.

A ray of the camera meets the board's plane z = 0 at (x, y) in mm in the board's frame; that point is lit from
(u, v) of the projector's image in px. All derivatives are analytic: of the inverse of the lens model by the
implicit function theorem, of the rest by the chain rule.
"""

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Floats, PixelIndices
from fpplab.core.geometry import Pinhole, RigidTransform, distort


def surface_and_projector_points(pixels: Floats, calibration: Calibration, pose: RigidTransform) -> Floats:
    # pixels (P, 2) px; returns (P, 4): x and y on the board in mm, column and row of the projector in px
    points = _rays_on_board(calibration.camera.normalise(pixels), pose)
    lit = calibration.projector.project(points, calibration.T_projector_camera)
    return np.concatenate([pose.inverse().apply(points)[:, :2], lit], axis=-1)


def surface_and_projector_jacobian(
    pixels: Floats, calibration: Calibration, pose: RigidTransform, free_intrinsics: int
) -> Floats:
    """Differentiate what pixels see of a board by every parameter."""
    # pixels (P, 2) px; returns (P, 4, 2 free_intrinsics + 12)
    camera, projector, pair = calibration.camera, calibration.projector, calibration.T_projector_camera
    slopes = camera.normalise(pixels)
    points = _rays_on_board(slopes, pose)
    by_point, by_local = _by_point(points, calibration, pose)
    rays = points / points[:, 2:]
    normal = pose.rotation[:, 2]
    fall = rays @ normal
    # along a ray, to stay in the plane: X = s r, s = n·t / n·r
    on_plane = points[:, 2, None, None] * (
        np.eye(3)[:, :2] - rays[:, :, None] * normal[None, None, :2] / fall[:, None, None]
    )
    by_camera = by_point @ on_plane @ _by_intrinsics(slopes, camera)[..., :free_intrinsics]
    local = pair.apply(points)
    by_projector = np.zeros((len(points), 4, free_intrinsics))
    by_projector[:, 2:] = _pixels_by_intrinsics(local[:, :2] / local[:, 2:], projector)[..., :free_intrinsics]
    by_pair = np.zeros((len(points), 4, 6))
    by_pair[:, 2:, :3] = by_local @ -_cross_product_matrices(local - pair.translation)
    by_pair[:, 2:, 3:] = by_local
    depth_by_turn = np.cross(normal, pose.translation - points) / fall[:, None]
    by_turn = by_point @ (rays[:, :, None] * depth_by_turn[:, None])
    # the board's own frame turns too
    by_turn[:, :2] += (pose.rotation.T @ _cross_product_matrices(points - pose.translation))[:, :2]
    by_move = _by_move(points, by_point, pose)
    return np.concatenate([by_camera, by_projector, by_pair, by_turn, by_move], axis=-1)


def _by_move(points: Floats, by_point: Floats, pose: RigidTransform) -> Floats:
    """Differentiate places (P, 4, 3) by a displacement of the board along the camera's axes."""
    rays, normal = points / points[:, 2:], pose.rotation[:, 2]
    along = (by_point @ rays[:, :, None]) / (rays @ normal)[:, None, None]
    by_move = along * normal
    by_move[:, :2] -= pose.rotation.T[:2]  # the board's own frame moves too
    return np.asarray(by_move)


def slopes_by_move(
    pixels: PixelIndices, calibration: Calibration, pose: RigidTransform, gradient: Floats
) -> Floats:
    """Differentiate levels by a displacement of the board."""
    # gradient (n, P, 4); returns (n, P, 3)
    points = np.stack(pixels[::-1], axis=-1).astype(np.float64)
    surface = _rays_on_board(calibration.camera.normalise(points), pose)
    by_point, _ = _by_point(surface, calibration, pose)
    return np.asarray(np.einsum("npk,pka->npa", gradient, _by_move(surface, by_point, pose)))


def _rays_on_board(slopes: Floats, pose: RigidTransform) -> Floats:
    """Where rays (P, 2) meet the board, (P, 3) in the camera's frame."""
    rays = np.concatenate([slopes, np.ones((len(slopes), 1))], axis=-1)
    normal = pose.rotation[:, 2]
    return np.asarray(rays * ((normal @ pose.translation) / (rays @ normal))[:, None])


def _by_point(points: Floats, calibration: Calibration, pose: RigidTransform) -> tuple[Floats, Floats]:
    """Differentiate places (P, 4, 3) by the point, and u, v (P, 2, 3) by it in the projector's frame."""
    projector, pair = calibration.projector, calibration.T_projector_camera
    x, y, z = pair.apply(points).T
    _, _, xx, xy, yy = distort(x / z, y / z, projector.distortion)
    bent = np.stack([np.stack([xx, xy], axis=-1), np.stack([xy, yy], axis=-1)], axis=-2)
    bent *= np.diag(projector.matrix)[:2, None]
    zero = np.zeros_like(z)
    to_slopes = np.stack(
        [np.stack([1 / z, zero, -x / z**2], axis=-1), np.stack([zero, 1 / z, -y / z**2], axis=-1)], axis=-2
    )
    by_local = bent @ to_slopes
    on_board = np.broadcast_to(pose.rotation.T[:2], (len(points), 2, 3))
    return np.concatenate([on_board, by_local @ pair.rotation], axis=1), by_local


def _by_intrinsics(slopes: Floats, camera: Pinhole) -> Floats:
    """Differentiate the slopes of fixed pixels by the intrinsics of the camera, (P, 2, 12)."""
    _, _, xx, xy, yy = distort(slopes[:, 0], slopes[:, 1], camera.distortion)
    determinant = xx * yy - xy * xy
    inverse = np.stack([np.stack([yy, -xy], axis=-1), np.stack([-xy, xx], axis=-1)], axis=-2)
    inverse /= determinant[:, None, None] * np.diag(camera.matrix)[:2]
    return np.asarray(-inverse @ _pixels_by_intrinsics(slopes, camera))


def _pixels_by_intrinsics(slopes: Floats, device: Pinhole) -> Floats:
    """Differentiate the pixels of fixed slopes by the intrinsics, (P, 2, 12)."""
    x, y = slopes.T
    k1, k2, _, _, k3, k4, k5, k6 = device.distortion
    xd, yd, *_ = distort(x, y, device.distortion)
    square = x * x + y * y
    below = 1.0 / (1.0 + square * (k4 + square * (k5 + square * k6)))
    radial = (1.0 + square * (k1 + square * (k2 + square * k3))) * below
    fx, fy = np.diag(device.matrix)[:2]
    out = np.zeros((len(x), 2, 12))
    out[:, 0, 0], out[:, 1, 1] = xd, yd
    out[:, 0, 2] = out[:, 1, 3] = 1.0
    grown = {4: square, 5: square**2, 8: square**3}
    shrunk = {9: -square * radial, 10: -(square**2) * radial, 11: -(square**3) * radial}
    for term, share in {**grown, **shrunk}.items():
        out[:, 0, term], out[:, 1, term] = fx * x * share * below, fy * y * share * below
    out[:, 0, 6], out[:, 1, 6] = fx * 2 * x * y, fy * (square + 2 * y * y)
    out[:, 0, 7], out[:, 1, 7] = fx * (square + 2 * x * x), fy * 2 * x * y
    return out


def _cross_product_matrices(vectors: Floats) -> Floats:
    """Matrices (P, 3, 3) that multiply like the cross products with vectors (P, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
