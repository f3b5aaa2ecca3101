"""How far points lie from their epipolar curves, and a refined board from its drawing."""

from __future__ import annotations

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.result import Characterisation
from fpplab.core.conventions import Floats
from fpplab.core.errors import DataError


def epipolar_distances(observation: Observation, calibration: Calibration) -> Floats:
    """Compute the signed distance of each point from its epipolar curve on the projector."""
    # A camera pixel is a ray, whose image on the projector is a curve (a line without distortion); the
    # distance is that of the projector's point from it, at the depth at which both rays pass nearest,
    # positive to the right of the direction in which depth moves it. Unlike the reprojection errors it does
    # not depend on the board.
    # returns (K,) px
    pair_of, projector = calibration.T_projector_camera, calibration.projector
    slopes = calibration.camera.normalise(observation.camera_px)
    rays = np.column_stack([slopes, np.ones(len(slopes))])
    depth = _depths(rays, observation.projector_px, calibration)
    at, beyond = (projector.project(rays * z[:, None], pair_of) for z in (depth, depth * (1.0 + 1e-4)))
    along = (beyond - at) / np.linalg.norm(beyond - at, axis=1)[:, None]
    differences = observation.projector_px - at
    return np.asarray(along[:, 0] * differences[:, 1] - along[:, 1] * differences[:, 0])


def _depths(rays: Floats, projector_px: Floats, calibration: Calibration) -> Floats:
    """Depths (K,) in mm at which the camera's rays (K, 3) pass nearest to the projector's rays."""
    slopes = calibration.projector.normalise(projector_px)
    turned = np.column_stack([slopes, np.ones(len(slopes))]) @ calibration.T_projector_camera.rotation
    across = np.cross(rays, turned)
    away = np.cross(np.broadcast_to(calibration.projector_centre, rays.shape), turned)
    return np.asarray((away * across).sum(axis=1) / (across**2).sum(axis=1))


def board_deviation(characterisation: Characterisation) -> tuple[Floats, Floats]:
    """Compute how far the refined board differs from the board as drawn."""
    # Position, rotation and scale of the board do not count; no image can separate the scale from the
    # distance.
    # returns (K, 3) mm
    if characterisation.drawn is None:
        raise DataError("the board was taken as it is drawn; there is no shape to show")
    detected = np.unique(np.concatenate([o.ids for o in characterisation.observations]))
    drawn = characterisation.drawn[detected]
    return drawn, 1e3 * (align_similarity(characterisation.board[detected], drawn) - drawn)


def align_similarity(points: Floats, onto: Floats) -> Floats:
    """Align points with others by the least-squares rotation, translation and scale."""
    # points (K, 3); onto (K, 3); returns (K, 3)
    centre, target_centre = points.mean(axis=0), onto.mean(axis=0)
    u, sizes, vt = np.linalg.svd((onto - target_centre).T @ (points - centre))
    handed = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    scale = (sizes * handed).sum() / ((points - centre) ** 2).sum()
    return np.asarray(scale * (points - centre) @ ((u * handed) @ vt).T + target_centre)
