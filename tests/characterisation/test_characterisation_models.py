"""How much of the distortion is fitted, and whether the board's shape is, judged by poses left out."""

import numpy as np
import pytest

from fpplab.characterisation import DistortionModel, Observation, bundle, characterise
from fpplab.characterisation.problem import without_poses
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


@pytest.mark.whole
@pytest.mark.parametrize("level", list(DistortionModel))
def test_a_level_frees_its_terms_alone(level: DistortionModel) -> None:
    seen = seen_with(TRUTHS["k1"])[:6]
    found = characterise(seen, BOARD, CAMERA.size, SQUARE.size, level=level, validate=False)
    held = HELD[level].split()
    for device, model in (("camera", found.calibration.camera), ("projector", found.calibration.projector)):
        for term, value in zip(DISTORTION, model.distortion, strict=True):
            assert (value == 0) == (term in held)
            assert (f"{device}.{term}" in found.sigma) == (term not in held)
    assert found.level is level
    assert [t.level for t in found.trials] == [level]
    assert found.calibration.rms_px["camera"] == pytest.approx(0.02 * np.sqrt(2), rel=0.1)


@pytest.mark.nightly
@pytest.mark.parametrize("truth", list(TRUTHS))
def test_the_default_holds_every_lens_up_to_k3_and_rational_the_rest(truth: str) -> None:
    level = DistortionModel.RATIONAL if truth == "rational" else "auto"
    found = characterise(seen_with(TRUTHS[truth]), BOARD, CAMERA.size, SQUARE.size, level=level)
    expected = Pinhole(CAMERA.size, CAMERA.matrix, np.array(TRUTHS[truth]))
    x, y = np.meshgrid(np.linspace(-0.1, 0.1, 5), np.linspace(-0.08, 0.08, 5))
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    off = found.calibration.camera.project(rays) - expected.project(rays)
    assert np.abs(off - off.mean(axis=0)).max() < 0.5
    assert found.calibration.rms_px["camera"] == pytest.approx(0.02 * np.sqrt(2), rel=0.1)


@pytest.mark.whole
def test_every_level_is_tried_and_the_default_is_kept() -> None:
    found = characterise(seen_with(TRUTHS["k3"])[:8], BOARD, CAMERA.size, SQUARE.size, level="auto")
    assert found.level is DistortionModel.K3
    assert [t.level for t in found.trials] == list(DistortionModel)
    held_out = [t.held_out_px["camera"] for t in found.trials if t.held_out_px]
    assert held_out[3] < 0.9 * min(held_out[:3]), "the levels below hold what this lens needs at zero"
    trial = found.trials[list(DistortionModel).index(found.level)]
    assert found.leave_one_out_px == pytest.approx(trial.held_out_px, rel=0.1)
    assert found.calibration.rms_px == pytest.approx(trial.fitted_px)


@pytest.mark.whole
def test_the_result_names_the_model_and_what_else_was_tried() -> None:
    found = characterise(seen_with(TRUTHS["k2"])[:8], BOARD, CAMERA.size, SQUARE.size, level="auto")
    summary = found.summary()
    assert summary["model"] == "k3"
    assert [m["model"] for m in summary["models"]] == ["k1", "k2", "tangential", "k3", "rational"]
    for entry, trial in zip(summary["models"], found.trials, strict=True):
        assert trial.held_out_px is not None
        assert entry["fitted"]["camera_px"] == trial.fitted_px["camera"]
        assert entry["held_out"]["projector_px"] == trial.held_out_px["projector"]
    facts = found.facts()
    assert facts["Model"] == "k3: distortion k1 k2 p1 p2 k3"
    assert "px in poses left out" in facts["Error with k1"]


@pytest.mark.whole
def test_three_poses_leave_none_to_judge_by_and_the_result_says_so() -> None:
    few = seen_with(TRUTHS["k1"])[:3]
    found = characterise(few, BOARD, CAMERA.size, SQUARE.size)
    assert [t.level for t in found.trials] == [DistortionModel.K3]
    assert found.warnings[0].startswith("3 poses leave none to judge the distortion by, so k3 was taken")
    named = characterise(few, BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.K1)
    assert not any("judge" in warning for warning in named.warnings)
    four = characterise(seen_with(TRUTHS["k1"])[:4], BOARD, CAMERA.size, SQUARE.size)
    assert [t.level for t in four.trials] == list(DistortionModel)


@pytest.mark.whole
def test_fits_without_a_pose_are_those_of_the_other_poses() -> None:
    seen = seen_with(TRUTHS["k2"])[:6]
    found = characterise(seen, BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.K2, validate=False)
    assert found.solution
    assert found.sizes
    assert found.model
    first = bundle.fits_without_each_pose(seen, found.solution, found.model, found.sizes)
    others = without_poses(found.solution, 2)
    again, _ = bundle.adjust_bundle([*seen[:2], *seen[3:]], others, found.model, found.sizes)
    for device in ("camera", "projector"):
        moved = getattr(again, device)[:2] - getattr(found.solution, device)[:2]
        at_once = getattr(first[2], device)[:2] - getattr(found.solution, device)[:2]
        assert at_once == pytest.approx(moved, rel=0.05, abs=0.05 * found.sigma[f"{device}.fx"])


@pytest.mark.whole
def test_the_board_is_refined_as_asked() -> None:
    drawn, tight = BOARD.points(), BOARD.model_copy(update={"tolerance_mm": 0.05})
    seen = seen_with(TRUTHS["k1"])[:6]

    def moved(target, refine):  # type: ignore[no-untyped-def]
        how = {"level": DistortionModel.K1, "refine_board": refine, "validate": False}
        found = characterise(seen, target, CAMERA.size, SQUARE.size, **how)
        return not np.array_equal(found.board, drawn)

    assert [moved(BOARD, refine) for refine in (None, False, True)] == [True, False, True]
    assert [moved(tight, refine) for refine in (None, False, True)] == [True, False, True]
