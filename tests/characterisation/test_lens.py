"""A lens whose scale differs between poses is told from noise and from a board that moved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fpplab.characterisation import Characterisation, DistortionModel, Observation, characterise
from fpplab.characterisation.lens import breathes, scales_of_poses
from tests.characterisation.test_judging import seen
from tests.support.rigs import BOARD, CAMERA, SQUARE


def fitted(observations: list[Observation]) -> Characterisation:
    return characterise(observations, BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.K3)


def scales(result: Characterisation) -> tuple[np.ndarray, np.ndarray]:
    assert result.solution is not None
    assert result.sizes is not None
    return scales_of_poses(result.observations, result.solution, result.sizes)


def breathing(amount: float, seed: int) -> list[Observation]:
    centre, random = CAMERA.matrix[:2, 2], np.random.default_rng(seed)
    grown = 1.0 + amount * random.standard_normal(9)
    return [
        replace(one, camera_px=centre + (one.camera_px - centre) * by)
        for one, by in zip(seen(9, seed), grown, strict=True)
    ]


def test_a_lens_that_breathes_is_named_and_a_locked_one_is_not() -> None:
    assert breathes(*scales(fitted(breathing(5e-4, 21))))
    still, sigmas = scales(fitted(breathing(0.0, 22)))
    assert not breathes(still, sigmas)
    assert np.abs(still / sigmas).max() < 4.0


def test_one_pose_alone_is_no_lens() -> None:
    off = np.zeros(9)
    off[4] = 1e-3
    assert not breathes(off, np.full(9, 3e-5))
