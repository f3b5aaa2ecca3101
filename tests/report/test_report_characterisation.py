"""Figures of a characterisation: epipolar distances, and the shape of the board."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.calibration.model import Calibration
from fpplab.characterisation import Characterisation, DistortionModel, characterise
from fpplab.characterisation.result import align_similarity, board_deviation, epipolar_distances
from fpplab.core.conventions import Floats
from fpplab.core.errors import DataError
from fpplab.core.geometry import RigidTransform
from fpplab.report.characterisation_figures import board_shape, epipolar_figure
from fpplab.report.measurements import write_report
from tests.support.rigs import BOARD, CAMERA, PAIR, SQUARE, observed, poses

TRUE = Calibration(CAMERA, SQUARE, PAIR, {})


def bent() -> Floats:
    """The board's points up to 0.2 mm out of its plane and 0.1 mm along it."""
    points = BOARD.points()
    x, y, _ = points.T
    return np.asarray(points + np.column_stack([0.1 * np.sin(x / 9), 0 * x, 0.2 * np.cos(x / 15) * y / 13]))


@pytest.fixture(scope="module")
def refined() -> Characterisation:
    seen = observed(poses(6), noise_px=0.01, points=bent())
    return characterise(
        seen, BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.TANGENTIAL, refine_board=True
    )  # fmt: skip


def test_true_devices_have_no_epipolar_distances() -> None:
    for seen in observed(poses(3), points=bent()):
        assert np.abs(epipolar_distances(seen, TRUE)).max() < 1e-8


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_epipolar_distance_ignores_displacement_along_the_line(along_px: float, across_px: float) -> None:
    """Distortion bends the lines: at 0.3 px along one they leave its tangent by far less than 1e-5 px."""
    (seen,), (held,) = observed(poses(1)), poses(1)
    points = held.apply(BOARD.points())
    step = SQUARE.project(1.0001 * points, PAIR) - SQUARE.project(points, PAIR)
    along = step / np.linalg.norm(step, axis=1)[:, None]
    across = np.column_stack([-along[:, 1], along[:, 0]])
    moved = replace(seen, projector_px=seen.projector_px + along_px * along + across_px * across)
    assert epipolar_distances(moved, TRUE) == pytest.approx(across_px, abs=1e-5)


@given(st.tuples(*[st.floats(-1, 1)] * 6), st.floats(0.9, 1.1))
def test_position_rotation_and_scale_are_removed(pose: tuple[float, ...], scale: float) -> None:
    held = RigidTransform.from_vectors(np.array(pose[:3]), np.array(pose[3:]))
    assert align_similarity(scale * held.apply(bent()), bent()) == pytest.approx(bent(), abs=1e-9)


def test_the_deviation_is_that_of_the_board(refined: Characterisation) -> None:
    drawn, deviation = board_deviation(refined)
    assert drawn == pytest.approx(BOARD.points())
    truth = 1e3 * (align_similarity(bent(), BOARD.points()) - BOARD.points())
    assert np.sqrt(np.mean((deviation - truth) ** 2)) < 0.15 * np.sqrt(np.mean(truth**2))


def test_a_board_taken_as_drawn_has_no_shape_to_show() -> None:
    level = DistortionModel.TANGENTIAL
    flat = characterise(observed(poses(4)), BOARD, CAMERA.size, SQUARE.size, level=level, refine_board=False)
    assert flat.drawn is None
    with pytest.raises(DataError, match="as it is drawn"):
        board_shape(flat)


@pytest.mark.whole
def test_the_page_shows_both(refined: Characterisation, tmp_path: Path) -> None:
    assert epipolar_figure(refined).startswith(b"\x89PNG")
    write_report(tmp_path / "c.html", "Characterisation", characterisation=refined)
    page = (tmp_path / "c.html").read_text(encoding="utf-8")
    assert "Epipolar distances by pose" in page
    assert "Shape of the board as refined" in page
    write_report(tmp_path / "f.html", "Flat", characterisation=replace(refined, drawn=None))
    assert "Shape of the board" not in (tmp_path / "f.html").read_text(encoding="utf-8")
