"""A projector whose picture walks is told from one at rest, from a board that moved, and from a lens."""

from dataclasses import replace

import numpy as np
import pytest

from fpplab.characterisation import DistortionModel, Observation
from fpplab.characterisation.drift import drift_cost_mm, fit_with_drift
from fpplab.characterisation.fitting import fit_consistent_poses, model_of
from tests.characterisation.test_judging import BENT, seen
from tests.support.breathing_lens import breathing
from tests.support.rigs import BOARD, CAMERA, SQUARE, observed, poses


def _fit(observations: list[Observation]):
    model = model_of(BOARD, (CAMERA.size, SQUARE.size), DistortionModel.K3)
    kept, fit, _ = fit_consistent_poses(observations, BOARD, model, {})
    return fit, fit_with_drift(kept, fit, model), model


def _shifted(at: np.ndarray) -> list[Observation]:
    boards = seen(9, 31)
    return [replace(o, projector_px=o.projector_px + by) for o, by in zip(boards, at, strict=True)]


@pytest.mark.whole
def test_a_picture_that_walks_is_fitted_and_in_the_uncertainty() -> None:
    walk = np.cumsum(np.random.default_rng(7).normal(0.0, 0.3, (9, 2)), axis=0)
    boards = _shifted(walk - walk[-1])
    still, drifting, model = _fit(boards)
    assert drifting is not None
    solution, sizes = drifting
    assert sizes.drift_px == pytest.approx(np.diff(walk, axis=0).std(), rel=0.2)
    assert (
        np.abs([solution.shift_px(k) - walk[k] + walk[-1] for k in range(9)]).max() < 0.2
    )  # of a walk of 0.6 px
    shifted = drift_cost_mm(boards, drifting, model) / sizes.drift_px
    assert 0.05 < shifted < 5.0
    wrong, right = (np.abs(f[0].projector[2:4] - SQUARE.matrix[:2, 2]).max() for f in (still, drifting))
    assert right < wrong


@pytest.mark.whole
def test_a_moved_board_and_a_breathing_lens_are_no_drift() -> None:
    assert _fit(_shifted(np.zeros((9, 2))))[1] is None
    assert _fit(_shifted(0.4 * (np.arange(9) == 4)[:, None] * np.ones(2)))[1] is None
    assert _fit(breathing(5e-4, 21))[1] is None


@pytest.mark.whole
def test_points_seen_very_well_are_no_fault_of_the_poses() -> None:
    """Steps leave residuals as small as noise, beside which a free step must still be determined."""
    walk = np.cumsum(np.random.default_rng(8).normal(0.0, 0.1, (12, 2)), axis=0)
    exact = observed(poses(12, seed=32), noise_px=0.003, points=BENT, seed=32)
    boards = [replace(o, projector_px=o.projector_px + by) for o, by in zip(exact, walk, strict=True)]
    _, drifting, _ = _fit(boards)
    assert drifting is not None
    assert drifting[1].drift_px == pytest.approx(0.1, rel=0.3)


def test_steps_that_cannot_be_told_are_not_fitted() -> None:
    """Of a twin's own frames: beside errors this small a free step leaves the equations undetermined."""
    boards, model = seen(9, 31), model_of(BOARD, (CAMERA.size, SQUARE.size), DistortionModel.K3)
    _, (solution, sizes), _ = fit_consistent_poses(boards, BOARD, model, {})
    exact = replace(sizes, camera_px=1e-6, projector_px=1e-6)
    assert fit_with_drift(boards, (solution, exact), model) is None
