"""The gain of a plan and its uncertainty, from an evaluator with known results."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fpplab.calibration.model import Calibration, Uncertainty
from fpplab.core import config
from fpplab.core.errors import ConfigError
from fpplab.optimisation import confirm as module
from fpplab.optimisation.arrangement import StageCalibrations
from fpplab.optimisation.candidate import Candidate
from fpplab.optimisation.confirm import Confirmation, compare_plans
from fpplab.optimisation.scoring import ArtefactFigures
from fpplab.optimisation.study import Study
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from tests.support.rigs import CAMERA, PAIR, SQUARE

BEFORE = Plan(fringes=(Sinusoid(axis="x", stripes=1, steps=12), Sinusoid(axis="x", stripes=16, steps=12)))
AFTER = BEFORE.model_copy(update={"fringes": (BEFORE.fringes[0], Sinusoid(axis="x", stripes=64, steps=6))})
EXACT = Calibration(CAMERA, SQUARE, PAIR, {})
SIGMA_PX = 0.5
UNSURE = replace(EXACT, uncertainty=Uncertainty(("camera.fx",), np.array([[SIGMA_PX**2]])))
FIGURES = ArtefactFigures(100, 0.0, 50.0, 43.0, 0.0, 1.0, 0.0, 0.0, 0.05)


def study() -> Study:
    return config.validate(
        {
            "name": "test", "artefacts": ["steps", "pillars"], "space": {"stripes": [None, [8, 128]]},
            "start": BEFORE.model_dump(mode="json", exclude_none=True),
            "objectives": ["surface_smcd_um"], "method": {"kind": "coordinate"},
        },
        Study, "study",
    )  # fmt: skip


class Evaluator:
    """100 µm before and 40 µm after, with 5 and 1 µm of noise; each px of focal length adds 2 µm to both."""

    known = StageCalibrations({None: EXACT})
    random = np.random.default_rng(3)

    def __init__(self, rig: str, study: Study, samples: int) -> None:
        self.calibrations, self.closed, self.asked = self.known, False, []  # type: ignore[var-annotated]
        Evaluator.last = self  # type: ignore[attr-defined]

    def figures(
        self, name: str, candidate: Candidate, seed: int, calibrations: StageCalibrations | None = None
    ) -> ArtefactFigures:
        fine = candidate.fringes[1].stripes == 64
        if calibrations is None:
            self.asked.append((name, fine, seed))
            off = self.random.normal(0.0, 1.0 if fine else 5.0)
        else:
            off = 2.0 * (calibrations.at().camera.matrix[0, 0] - CAMERA.matrix[0, 0])
        return replace(FIGURES, surface_smcd_um=(40.0 if fine else 100.0) + off)

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def evaluator(monkeypatch: pytest.MonkeyPatch) -> type[Evaluator]:
    monkeypatch.setattr(module, "RigEvaluator", Evaluator)
    return Evaluator


def test_gain_is_within_its_uncertainty_and_plans_alternate(evaluator: Any) -> None:
    found = compare_plans("rig", study(), BEFORE, AFTER, repeats=50)
    assert abs(found.gain - 0.6) < 4.0 * found.uncertainty
    # Of two artefacts and 50 repeats: 1 µm of 100 after, 5 µm of 100 times 0.4 before.
    expected = np.hypot(1.0, 5.0 * 0.4) / 100.0 / np.sqrt(2 * 50)
    assert found.by_repeat == pytest.approx(expected, rel=0.35)
    assert found.by_calibration == 0.0
    asked = evaluator.last.asked
    assert [fine for _, fine, _ in asked] == [False, True] * 100
    assert asked[0::2] == [(name, False, seed) for name, _, seed in asked[1::2]]
    assert evaluator.last.closed


def test_sample_uncertainty_does_not_average_out_over_repeats() -> None:
    of_one = tuple(replace(FIGURES, surface_smcd_um=50.0 + k) for k in (-1.0, 0.0, 1.0))
    better = tuple(replace(one, surface_smcd_um=one.surface_smcd_um / 2) for one in of_one)
    found = Confirmation({"steps": of_one}, {"steps": better}, 0.0)
    assert found.gain == pytest.approx(0.5)
    assert found.by_repeat == pytest.approx(0.0, abs=1e-12)
    assert found.by_sample == pytest.approx(0.5 * np.hypot(0.05 / 50.0, 0.05 / 25.0))
    summary = found.summary()
    assert summary["uncertainty"] == pytest.approx(found.by_sample)
    assert summary["before"]["artefacts"]["steps"]["surface_smcd_um"] == pytest.approx(50.0)
    assert summary["after"]["surface_smcd_um"] == pytest.approx(25.0)


def test_calibration_uncertainty_is_common_to_both_plans(
    evaluator: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluator, "known", StageCalibrations({None: UNSURE}))
    found = compare_plans("rig", study(), BEFORE, AFTER, repeats=2)
    # 2 µm per px on both, so the gain moves by 2 (0.4 - 1)/100 per px.
    expected = 2.0 * 0.6 / 100.0 * SIGMA_PX
    assert found.by_calibration == pytest.approx(
        expected, rel=4.0 / np.sqrt(2 * module.LIMITS.calibration_draws)
    )
    assert found.uncertainty >= found.by_calibration


def test_incomparable_plans_and_single_repeats_are_refused(evaluator: Any) -> None:
    with pytest.raises(ConfigError, match="--repeats: 1: at least 2"):
        compare_plans("rig", study(), BEFORE, AFTER, repeats=1)
    other = AFTER.model_copy(update={"unwrapping": "heterodyne"})
    with pytest.raises(ConfigError, match="differ in 'unwrapping'"):
        compare_plans("rig", study(), BEFORE, other)


def test_rig_is_closed_when_measuring_fails(evaluator: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*asked: object) -> ArtefactFigures:
        raise ConfigError("no")

    monkeypatch.setattr(evaluator, "figures", fail)
    with pytest.raises(ConfigError):
        compare_plans("rig", study(), BEFORE, AFTER)
    assert evaluator.last.closed
