"""Matching to recordings of other codes than fringes, of several exposures, and of a Bayer camera."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fpplab.core import config
from fpplab.core.errors import ConfigError
from fpplab.patterns.mosaic import Bayer
from fpplab.patterns.plan import Plan
from sim.matching.match import MatchingLimits
from sim.matching.passes import ComparedPass
from sim.matching.run import MatchingRequest, MatchingResult, match_sessions
from tests.support.plane_twin import TARGET, PlaneTwin, nominal, record, tilted

pytestmark = pytest.mark.whole

EVEN = {"kind": "even", "levels": [1, 0]}
FRINGES = [{"axis": axis, "stripes": stripes, "steps": 4} for axis in "xy" for stripes in (1, 8, 32)]
MICRO = [
    {"kind": "shifted", "axis": axis, "stripes": stripes, "shifts_deg": shifts}
    for axis in "xy"
    for stripes, shifts in (
        (20.3, [0, 120, 240]), (17.8, [0]), (23.4, [0]), (15.8, [0]), (18.4, [0]), (25.1, [0]), (18, [0])
    )
]  # fmt: skip
PLANS: dict[str, dict[str, Any]] = {
    "exposures": {"fringes": FRINGES, "exposures_s": [0.01, 0.04]},
    "gray": {
        "fringes": [
            {"kind": "gray", "axis": "x", "bits": 8, "cell_px": 2},
            {"kind": "gray", "axis": "y", "bits": 8, "cell_px": 2},
            EVEN,
        ]
    },
    "complementary": {
        "fringes": [
            {"axis": "x", "stripes": 24, "steps": 4},
            {"kind": "gray", "axis": "x", "bits": 6, "cell_px": 9.5},
            {"axis": "y", "stripes": 15, "steps": 4},
            {"kind": "gray", "axis": "y", "bits": 5, "cell_px": 9.5, "inverses": "each"},
            EVEN,
        ]
    },
    "micro": {"fringes": MICRO},
}


def plan_of(data: dict[str, Any]) -> Plan:
    return config.validate(data, Plan, "plan")


def matched(folder: Path, plan: Plan, bayer: Bayer | None = None) -> MatchingResult:
    truth = replace(
        nominal(tilted(4, seed=3)), white=0.85, ink=0.09, ambient=0.05, projector_blur=0.9
    )  # fmt: skip
    bench = PlaneTwin(truth, 1, by_exposure=True).with_filter(bayer, (0.8, 1.15, 0.9) if bayer else None)
    sessions = record(bench, plan, folder / "board", bayer)
    wanted = MatchingRequest(limits=MatchingLimits(epochs=3))
    return match_sessions(
        PlaneTwin(nominal(()), 7, by_exposure=True), sessions, TARGET, folder / "matched", wanted
    )


def check(result: MatchingResult, white: float = 0.85) -> None:
    losses = [epoch.loss["loss_board"] for epoch in result.matched.epochs if epoch.accepted]
    assert losses[-1] < 0.5 * losses[0]
    assert result.final.loss.summary()["ssim_board"] > 0.95
    now = result.matched.parameters
    assert now.white == pytest.approx(white, rel=0.03)
    assert now.ink == pytest.approx(0.09, abs=0.01)
    assert now.ambient == pytest.approx(0.05, abs=0.015)
    assert now.calibration.baseline_mm == pytest.approx(150.0, rel=2e-3)


@pytest.mark.whole_after(0, nightly=2)
@pytest.mark.parametrize("kind", PLANS)
def test_a_twin_is_matched_to_recordings_of_other_plans(kind: str, tmp_path: Path) -> None:
    check(matched(tmp_path, plan_of(PLANS[kind])))


def test_a_twin_is_matched_to_a_bayer_camera(tmp_path: Path) -> None:
    result = matched(tmp_path, plan_of({"fringes": FRINGES}), "RGGB")
    check(result)
    white = result.reference.characterisation.calibration.white
    assert white is not None
    assert np.array(white) / white[1] == pytest.approx(np.array([0.8, 1.15, 0.9]) / 1.15, abs=0.02)


def test_the_longest_exposure_that_is_not_saturated_is_compared(tmp_path: Path) -> None:
    plan = plan_of({"fringes": FRINGES[:1], "exposures_s": [0.01, 0.02, 0.2]})
    session = record(PlaneTwin(nominal(tilted(1, seed=3)), 1, by_exposure=True), plan, tmp_path)[0]
    assert ComparedPass.of(session).settings.exposure_s == 0.02


def test_images_that_no_exposure_has_together_are_refused(tmp_path: Path) -> None:
    fringes = [{**FRINGES[0], "exposures_s": [0.01]}, {**FRINGES[1], "exposures_s": [0.02]}]
    session = record(
        PlaneTwin(nominal(tilted(1, seed=3)), 1, by_exposure=True), plan_of({"fringes": fringes}), tmp_path
    )
    with pytest.raises(ConfigError, match="no exposure takes every image of the plan"):
        ComparedPass.of(session[0])
