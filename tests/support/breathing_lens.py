"""Poses of a board seen with a lens whose scale differs from pose to pose."""

from dataclasses import replace

import numpy as np

from fpplab.characterisation import Characterisation, DistortionModel, Observation, characterise
from fpplab.characterisation.lens import scales_of_poses
from tests.characterisation.test_judging import seen
from tests.support.rigs import BOARD, CAMERA, SQUARE


def fitted(observations: list[Observation]) -> Characterisation:
    return characterise(observations, BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.K3)


def scales(result: Characterisation) -> tuple[np.ndarray, np.ndarray]:
    assert result.solution is not None
    assert result.sizes is not None
    return scales_of_poses(result.observations, result.solution, result.sizes)


def breathing(amount: float, seed: int) -> list[Observation]:
    """Nine poses whose scales have that standard deviation, whatever is drawn."""
    centre, drawn = CAMERA.matrix[:2, 2], np.random.default_rng(seed).standard_normal(9)
    grown = 1.0 + amount * (drawn - drawn.mean()) / drawn.std(ddof=1)
    return [
        replace(one, camera_px=centre + (one.camera_px - centre) * by)
        for one, by in zip(seen(9, seed), grown, strict=True)
    ]
