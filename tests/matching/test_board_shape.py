"""The bend of the bench's board, and geometries that its points contradict."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from fpplab.calibration.model import Calibration, Uncertainty
from fpplab.characterisation import DistortionModel
from fpplab.characterisation.parameters import parameter_names
from fpplab.matching import geometry
from fpplab.matching.board_shape import bend_mm, bend_moves
from fpplab.matching.reference import Reference
from fpplab.simulation.matchable import TwinParameters
from tests.matching.test_matching import reference_of, truth
from tests.support.plane_twin import CAMERA, PAIR, PROJECTOR, TARGET, PlaneTwin

__all__ = ["truth"]  # a fixture


def bent() -> np.ndarray[Any, np.dtype[np.float64]]:
    """The board's points on a shallow bowl with a twist."""
    board = TARGET.points()
    x, y = board[:, 0] / 30.0, board[:, 1] / 20.0
    board[:, 2] = 0.02 * x**2 - 0.01 * x * y + 0.004 * y**3
    return board


def test_bend_is_interpolated_and_goes_on_beyond_the_points() -> None:
    places = np.array([[3.0, -5.0], [-20.0, 11.0], [0.0, 0.0]])
    x, y = places.T / [[30.0], [20.0]]
    np.testing.assert_allclose(bend_mm(bent(), places), 0.02 * x**2 - 0.01 * x * y + 0.004 * y**3, atol=1e-9)
    most = bent()[:, :2].max(axis=0)
    beyond = bend_mm(bent(), np.array([most, 2 * most]))
    assert beyond[0] == pytest.approx(beyond[1])
    assert not bend_mm(TARGET.points(), places).any()


def test_a_bent_board_is_not_taken_for_another_geometry(truth: TwinParameters) -> None:
    """Images of a flat twin to which the bend is added to first order: the step stays where it is."""
    flat = reference_of(truth)
    known = SimpleNamespace(poses=truth.poses, calibration=flat.characterisation.calibration, board=bent())
    reference = Reference(flat.sessions, TARGET, cast(Any, known))
    rows, columns = np.array([150, 160]), np.array([200, 240])
    moves = bend_moves(reference, truth, 0, (rows, columns))
    normal = truth.poses[0].rotation[:, 2]
    np.testing.assert_allclose(np.cross(moves, normal), 0.0, atol=1e-12)
    assert np.abs(moves).max() > 1e-4
    with_bend = geometry._residual_of_pose(reference, PlaneTwin(truth), truth, 0)
    without = geometry._residual_of_pose(flat, PlaneTwin(truth), truth, 0)
    change = (without.residual - with_bend.residual)[0]
    view = without
    pixels = view.pixels
    points = np.stack(pixels[::-1], axis=-1).astype(np.float64)
    by_move = geometry.place_jacobian(points, truth.calibration, truth.poses[0], 0)[..., -3:]
    slopes = np.einsum("pk,pka->pa", view.level_gradient[0], by_move)
    expected = np.einsum("pa,pa->p", slopes, bend_moves(reference, truth, 0, pixels))
    np.testing.assert_allclose(change, np.where(view.valid[0], expected, 0.0), atol=1e-9)
    assert np.abs(change).max() > 0.1


def test_geometries_beyond_what_points_tell_are_contradicted(truth: TwinParameters) -> None:
    level = DistortionModel.TANGENTIAL
    names = parameter_names(level)
    sigma = np.where([name.endswith(("fx", "fy", "cx", "cy")) for name in names], 0.2, 1e-3)
    known = Calibration(CAMERA, PROJECTOR, PAIR, {}, Uncertainty(names, np.diag(sigma**2)))
    found = cast(Any, SimpleNamespace(calibration=known, level=level, poses=truth.poses))
    reference = Reference((), TARGET, found)
    random = np.random.default_rng(2)

    def moved(factor: float) -> TwinParameters:
        matrix = CAMERA.matrix.copy()
        matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += factor * 0.2 * np.abs(random.standard_normal(4))
        calibration = replace(known, camera=replace(CAMERA, matrix=matrix))
        return replace(truth, calibration=calibration)

    assert geometry.contradiction(reference, moved(0.0)) == 0.0
    assert geometry.contradiction(reference, moved(1.0)) < 1.0
    assert geometry.contradiction(reference, moved(20.0)) > 1.0
    bare = replace(known, uncertainty=None)
    nothing = Reference((), TARGET, cast(Any, SimpleNamespace(calibration=bare, level=level, poses=())))
    assert geometry.contradiction(nothing, moved(20.0)) == 0.0
