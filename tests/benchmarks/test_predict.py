"""How predictions of twins of hidden benches are judged."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.predict import (
    ComparedFigure,
    JudgedBench,
    PredictSetup,
    errors_in_sigmas,
    figures,
    poses_off_um,
    steps_nearer_than_kept,
)
from fpplab.calibration.model import Uncertainty
from fpplab.core.geometry import RigidTransform
from sim.matching.record import MatchingEpoch, ParametersFile
from sim.parameters import TwinParameters
from tests.support.plane_twin import nominal, tilted


def test_poses_are_judged_relative_to_each_other() -> None:
    true = tilted(6)
    motion = RigidTransform.from_vectors(np.array([0.02, -0.01, 0.03]), np.array([5.0, -2.0, 1.0]))
    moved = [motion @ pose for pose in true]
    assert poses_off_um(moved, true).max() < 1e-6
    moved[2] = moved[2].moved(np.array([0.0, 0.0, 0.1]))
    off = poses_off_um(moved, true)
    assert off.argmax() == 2
    assert 60 < off[2] < 100
    mirrored = [
        RigidTransform(pose.rotation, pose.translation * [1, 1, -1]) for pose in true
    ]  # no rigid motion
    assert poses_off_um(mirrored, true).max() > 1000


def test_parameters_are_judged_by_their_own_uncertainty() -> None:
    truth = nominal(tilted(2))
    known = truth.calibration
    matrix = known.camera.matrix.copy()
    matrix[0, 2] += 0.6
    found = replace(
        truth,
        ink=truth.ink + 0.01,
        white=2.0,
        calibration=replace(
            known,
            camera=replace(known.camera, matrix=matrix),
            T_projector_camera=RigidTransform(
                known.T_projector_camera.rotation, known.T_projector_camera.translation + [0, 0.3, 0]
            ),
            uncertainty=Uncertainty(
                ("camera.cx", "projector.k1", "T_projector_camera.y"), np.diag([0.04, 1e-6, 0.01])
            ),
        ),
        sigma={"ink": 0.004, "white": 0.01, "poses_um": 3.0},
    )
    wanted = {"ink": 2.5, "camera.cx": 3.0, "projector.k1": 0.0, "T_projector_camera.y": 3.0}
    assert errors_in_sigmas(found, truth) == pytest.approx(wanted)


def test_what_images_do_not_tell_is_not_judged() -> None:
    """The scale of print and ground together, and a falloff that no world states."""
    truth = nominal(tilted(2))
    known = replace(truth, paper=1.1 * truth.paper, ink=1.1 * truth.ink, projector_falloff=(0.1, 0, 0, 0, 0))
    sigma = {"ink": 0.004, "paper": 0.001, "falloff_x": 0.01}
    assert errors_in_sigmas(replace(known, sigma=sigma), truth) == pytest.approx({"ink": 0.0})
    darker = replace(known, ink=known.ink - 0.008, sigma=sigma)
    assert errors_in_sigmas(darker, truth) == pytest.approx({"ink": -2.0})


def answers(value: float, distance: float) -> dict[str, ComparedFigure]:
    return {
        "distance_um": ComparedFigure(value, 0.9 * value, 1.1 * value, distance),
        "noise_um": ComparedFigure(1.0, 0.5, 2.0, 1.3, again=(1.3, 1.3 * value / distance)),
    }


def test_shares_of_predictions_are_counted() -> None:
    one = JudgedBench(
        1,
        is_good=True,
        nearer=("noise",),
        poses_um=(10.0, 20.0, 60.0),
        sigmas={"a": 1.0, "b": -4.0},
        answers={"plan": answers(10.0, 10.5), "pose": answers(10.0, 14.0)},
    )
    found = {result.name: result for result in figures([one, JudgedBench(2, refused="no")], "predict")}
    values = {name: result.value for name, result in found.items()}
    assert values == pytest.approx(
        {
            "predict_refused": 1,
            "predict_believed_wrong": 1,
            "predict_refused_steps_nearer": 1,
            "predict_poses": np.sqrt(4100 / 3),
            "predict_parameters_within_3_sigma": 0.5,
            "predict_distance_um_within_10_percent": 0.5,
            "predict_noise_um_within_10_percent": 0.0,
            "predict_noise_um_repeated_within_10_percent": 0.5,
            "predict_plan_off": (1 - 10 / 10.5 + 1 - 1 / 1.3) / 2,
            "predict_pose_off": (1 - 10 / 14 + 1 - 1 / 1.3) / 2,
            "predict_intervals_cover": 0.75,
            "predict_intervals_are_not_too_wide": 0.75,
        }
    )
    assert found["predict_refused"].ratio < 1
    assert found["predict_poses"].ratio == pytest.approx(30 / np.sqrt(4100 / 3))
    assert not replace(one, is_good=False).is_believed_wrong
    assert len(figures([JudgedBench(2, refused="no")], "predict")) == 3


def test_steps_taken_back_are_judged_by_the_truth() -> None:
    truth = nominal(tilted(2))
    start, near, far = (
        replace(truth, f_number=truth.f_number + off, sigma={"f_number": 0.1}) for off in (0.5, 0.2, 0.8)
    )

    def epoch(name: str, accepted: bool, parameters: TwinParameters) -> MatchingEpoch:
        return MatchingEpoch(
            epoch=0, step=name, accepted=accepted, loss={}, difference=0.0, seconds=0.0,
            parameters=ParametersFile.of(parameters),
        )  # fmt: skip

    epochs = [epoch("start", True, start), epoch("away", False, far), epoch("nearer", False, near)]
    assert list(steps_nearer_than_kept(epochs, truth)) == ["nearer: 3.0 σ, poses 0.0 µm"]
    apart = truth.poses[1].translation - truth.poses[0].translation
    further = truth.poses[1].moved(0.1 * apart / np.linalg.norm(apart))
    moved = replace(start, poses=(truth.poses[0], further), sigma={"poses_um": 20.0})
    epochs = [epoch("start", True, moved), epoch("images", False, replace(start, sigma={"poses_um": 20.0}))]
    assert list(steps_nearer_than_kept(epochs, truth)) == ["images: 0.0 σ, poses 50.0 µm"]
    epochs = [epoch("start", True, start), epoch("light", True, near)]
    assert list(steps_nearer_than_kept(epochs, truth)) == []


def test_development_and_judging_do_not_meet() -> None:
    assert min(PredictSetup().seeds) >= 5000
    assert len(PredictSetup().seeds) == 12
    assert len(PredictSetup().questions) == 5
    half = PredictSetup().questions[1].loaded()
    assert half.exposure_s == pytest.approx(0.01)
