"""Sizes of errors, as the joint adjustment estimates them, against those that were drawn."""

from dataclasses import astuple, replace

import numpy as np
import pytest

from fpplab.characterisation import DistortionModel, Observation
from fpplab.characterisation.bundle import adjust_bundle
from fpplab.characterisation.fitting import model_of
from fpplab.characterisation.pose_effects import smooth_functions
from fpplab.characterisation.problem import without_poses
from tests.support.rigs import BOARD, CAMERA, SQUARE, observed, poses, truth_of

NOISE_PX, COUNT = 0.02, 8


def disturbed(shared_px: float, seed: int) -> list[Observation]:
    """Noise, and errors that all points of a pose share."""
    random, smooth = np.random.default_rng(seed), smooth_functions(BOARD.points()[:, :2])
    off = smooth @ random.normal(0, 1.0, (COUNT, 2, 6, 2))
    return [
        replace(o, camera_px=o.camera_px + shared_px * c, projector_px=o.projector_px + shared_px * p)
        for o, (c, p) in zip(observed(poses(COUNT), noise_px=NOISE_PX, seed=seed), off, strict=True)
    ]


@pytest.mark.parametrize("shared_px", [0.005, 0.02, 0.06])
def test_noise_does_not_depend_on_what_poses_share(shared_px: float) -> None:
    seen, truth = disturbed(shared_px, 1), truth_of(poses(COUNT))
    model = model_of(BOARD, (CAMERA.size, SQUARE.size), DistortionModel.K2)
    solution, sizes = adjust_bundle(seen, truth, model)
    assert (sizes.camera_px, sizes.projector_px) == pytest.approx((NOISE_PX, NOISE_PX), rel=0.25)
    assert (sizes.camera_shared_px, sizes.projector_shared_px) == pytest.approx((shared_px,) * 2, rel=0.5)
    _, fewer = adjust_bundle(seen[1:], without_poses(solution, 0), model)
    assert astuple(fewer)[:2] == pytest.approx(astuple(sizes)[:2], rel=0.1)
