"""How much of the distortion is fitted, and whether the board's shape is, judged by poses left out."""

from __future__ import annotations

import numpy as np
import pytest

from fpplab.characterisation import DistortionModel, Observation, bundle, characterise, fitting
from fpplab.cli.commands.characterise import ModelName
from fpplab.core.geometry import DISTORTION, Pinhole
from tests.support.rigs import BOARD, CAMERA, PAIR, SQUARE, poses

HELD = {
    "k1": "k2 p1 p2 k3 k4 k5 k6",
    "k2": "p1 p2 k3 k4 k5 k6",
    "tangential": "k3 k4 k5 k6",
    "k3": "k4 k5 k6",
    "rational": "",
}
TRUTHS = {
    "k1": (-0.3, 0.0, 0.0, 0.0, 0.0),
    "k2": (-0.3, 2.5, 0.0, 0.0, 0.0),
    "tangential": (-0.3, 2.5, 6e-3, -8e-3, 0.0),
    "k3": (-0.3, 8.0, 6e-3, -8e-3, -90.0),
    "rational": (-0.3, 2.0, 1e-3, -1e-3, 0.0, 12.0, 20.0, 0.0),
}


def seen_with(distortion: tuple[float, ...], noise_px: float = 0.02) -> list[Observation]:
    camera = Pinhole(CAMERA.size, CAMERA.matrix, np.array(distortion))
    random, board, found = np.random.default_rng(2), BOARD.points(), []
    for k, transform in enumerate(poses(12)):
        points = transform.apply(board)
        pixels = camera.project(points), Pinhole(SQUARE.size, SQUARE.matrix).project(points, PAIR)
        noisy = [p + random.normal(0, noise_px, p.shape) for p in pixels]
        found.append(Observation(f"pose_{k}", np.arange(len(board)), *noisy))
    return found


def test_the_command_knows_every_level() -> None:
    assert [str(name) for name in ModelName] == [*DistortionModel, "auto"]


@pytest.mark.parametrize("level", list(DistortionModel))
def test_a_level_frees_its_terms_alone(level: DistortionModel) -> None:
    found = characterise(seen_with(TRUTHS["k1"]), BOARD, CAMERA.size, SQUARE.size, level=level)
    held = HELD[level].split()
    for device, model in (("camera", found.calibration.camera), ("projector", found.calibration.projector)):
        for term, value in zip(DISTORTION, model.distortion, strict=True):
            assert (value == 0) == (term in held)
            assert (f"{device}.{term}" in found.sigma) == (term not in held)
    assert found.level is level
    assert [t.level for t in found.trials] == [level]
    assert found.calibration.rms_px["camera"] == pytest.approx(0.02 * np.sqrt(2), rel=0.1)


@pytest.mark.parametrize("truth", list(TRUTHS))
def test_the_level_that_the_lens_needs_is_chosen(truth: str) -> None:
    found = characterise(seen_with(TRUTHS[truth]), BOARD, CAMERA.size, SQUARE.size, level="auto")
    assert found.level == truth, found.trials
    assert [t.level for t in found.trials] == list(DistortionModel)
    fitted = [t.fitted_px["joint"] for t in found.trials]
    assert np.diff(fitted).max() < 1e-6, "more freedom fits no worse"
    trial = found.trials[list(DistortionModel).index(found.level)]
    assert found.leave_one_out_px == trial.held_out_px
    assert found.calibration.rms_px == pytest.approx(trial.fitted_px)


def test_the_result_names_the_model_and_what_else_was_tried() -> None:
    found = characterise(seen_with(TRUTHS["k2"]), BOARD, CAMERA.size, SQUARE.size, level="auto")
    summary = found.summary()
    assert summary["model"] == "k2"
    assert [m["model"] for m in summary["models"]] == ["k1", "k2", "tangential", "k3", "rational"]
    for entry, trial in zip(summary["models"], found.trials, strict=True):
        assert trial.held_out_px is not None
        assert entry["fitted"]["camera_px"] == trial.fitted_px["camera"]
        assert entry["held_out"]["projector_px"] == trial.held_out_px["projector"]
    facts = found.facts()
    assert facts["Model"] == "k2: distortion k1 k2"
    assert "px in poses left out" in facts["Error with k3"]


def test_three_poses_take_the_simplest_level_and_say_so() -> None:
    few = seen_with(TRUTHS["k1"])[:3]
    found = characterise(few, BOARD, CAMERA.size, SQUARE.size)
    assert found.level is DistortionModel.K1
    assert [t.level for t in found.trials] == [DistortionModel.K1]
    assert found.warnings[0].startswith("3 poses leave none to judge the distortion by, so k1 was taken")
    assert "name the model" in found.warnings[0]
    named = characterise(few, BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.K1)
    assert not any("judge" in warning for warning in named.warnings)
    assert found.calibration.camera.matrix == pytest.approx(named.calibration.camera.matrix, rel=1e-6)
    four = characterise(seen_with(TRUTHS["k1"])[:4], BOARD, CAMERA.size, SQUARE.size)
    assert [t.level for t in four.trials] == list(DistortionModel)


def test_no_level_is_fitted_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    fitted: list[tuple[DistortionModel, int]] = []

    def counted(observations, start, model):  # type: ignore[no-untyped-def]
        fitted.append((model.level, len(observations)))
        return bundle.adjust_bundle(observations, start, model)

    monkeypatch.setattr(fitting, "adjust_bundle", counted)
    seen = seen_with(TRUTHS["k1"])[:5]
    for level in ("auto", *DistortionModel):
        fitted.clear()
        characterise(seen, BOARD, CAMERA.size, SQUARE.size, level=level)
        wanted = list(DistortionModel) if level == "auto" else [level]
        assert sorted(one for one, poses in fitted if poses == len(seen)) == sorted(wanted)


def test_the_board_is_refined_as_asked() -> None:
    drawn, tight = BOARD.points(), BOARD.model_copy(update={"tolerance_mm": 0.05})
    seen = seen_with(TRUTHS["k1"])[:6]

    def moved(target, refine):  # type: ignore[no-untyped-def]
        found = characterise(seen, target, CAMERA.size, SQUARE.size, refine_board=refine)
        return not np.array_equal(found.board, drawn)

    assert [moved(BOARD, refine) for refine in (None, False, True)] == [False, False, True]
    assert [moved(tight, refine) for refine in (None, False, True)] == [True, False, True]
