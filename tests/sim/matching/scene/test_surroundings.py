"""Surfaces beside the board go on where no fringe tells their shape, and end before a backdrop."""

import numpy as np
import pytest

from fpplab.core.conventions import Floats
from fpplab.core.geometry import Pinhole
from sim.matching.scene import surroundings

CAMERA = Pinhole.from_focal((330, 210), (900, 900), (160, 110), (-0.05, 0.03, 0, 0, 0))


def sloping(rows: int, columns: int) -> Floats:
    """Depths in mm of an inclined plane."""
    y, x = np.mgrid[:rows, :columns]
    return np.asarray(1.0 / (1e-3 * (1 + 0.002 * x + 0.003 * y)))


def test_a_plane_goes_on_as_a_plane() -> None:
    true = sloping(60, 80)
    known = true.copy()
    known[20:40, 15:50] = np.nan
    known[45:55, 60:] = np.nan
    found = surroundings.continue_surfaces(known)
    assert np.abs(found - true).max() < 0.02


def test_it_ends_where_it_is_as_near_or_far_as_anything_known() -> None:
    known = sloping(60, 80)
    known[:, 40:] = np.nan
    known[59] = np.nan
    near, far = np.nanmin(known), np.nanmax(known)
    found = surroundings.continue_surfaces(known)
    assert np.isfinite(found).all()
    assert found.min() == pytest.approx(near)
    assert found.max() == pytest.approx(far)


def test_it_does_not_go_on_for_ever() -> None:
    known = np.full((9, 100), np.nan)
    known[:, :10] = 500.0
    found = np.isfinite(surroundings.continue_surfaces(known)[4])
    assert found.sum() == 10 + surroundings.LIMITS.continued_cells


def test_the_backdrop_fills_the_image_behind_all_else() -> None:
    mesh = surroundings.backdrop_mesh(700.0, CAMERA)
    assert mesh.vertices[:, 2] == pytest.approx(700.0)
    u, v = CAMERA.project(np.asarray(mesh.vertices)).T
    assert (u.min(), v.min(), u.max(), v.max()) == pytest.approx((-1, -1, 330, 210), abs=0.01)
    assert (np.asarray(mesh.face_normals)[:, 2] < -0.99).all(), "its front is towards the camera"
