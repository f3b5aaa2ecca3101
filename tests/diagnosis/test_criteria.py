"""The named criteria of a verdict."""

from dataclasses import replace
from pathlib import Path

import pytest

from fpplab.diagnosis import Diagnosis, DiagnosisLimits, Verdict, diagnose_scan
from fpplab.diagnosis.criteria import CriteriaLimits
from fpplab.diagnosis.limits import USUAL_LIMITS
from fpplab.diagnosis.record import load_diagnosis, save_diagnosis
from fpplab.phase import decode
from fpplab.reconstruction.points import points_of
from tests.support.faulty_bench import Bench, faulty, healthy

EVERY = {"points", "wrong_order_risk", "contrast", "waves", "uncertainty"}


def judged(bench: Bench, limits: DiagnosisLimits = USUAL_LIMITS) -> Diagnosis:
    recording = bench.recording()
    decoded, cloud = points_of(
        decode(recording), bench.calibration, recording.plan, recording.mean_image()
    )  # fmt: skip
    return diagnose_scan(recording, decoded, cloud, bench.calibration, limits=limits)


@pytest.mark.whole
def test_a_good_scan_meets_every_criterion_and_says_so() -> None:
    found = judged(healthy(700))
    assert found.verdict is Verdict.GOOD
    assert {one.name for one in found.criteria} - {"epipolar_residual"} == EVERY
    assert all(one.is_met for one in found.criteria)
    told = found.summary()["criteria"]
    assert isinstance(told, list)
    assert {"name", "value", "unit", "met"} < set(told[0])


@pytest.mark.whole
def test_noise_of_the_coordinate_is_that_of_the_plan_on_a_white_surface() -> None:
    """A quarter of the light on a camera whose noise is that of photons: twice the noise, and no less."""
    bench = replace(healthy(701), flicker=0.0)
    bench = replace(bench, parameters=replace(bench.parameters, read_noise_e=0.5, paper=0.9, ink=0.9))
    bright = replace(bench, parameters=replace(bench.parameters, white=0.9))
    dim = replace(bench, parameters=replace(bench.parameters, white=0.225))
    by_name = [{one.name: one.value for one in judged(b).criteria} for b in (bright, dim)]
    assert by_name[1]["uncertainty"] / by_name[0]["uncertainty"] == pytest.approx(2.0, rel=0.15)


@pytest.mark.whole
def test_a_calibration_of_another_time_misses_the_criterion_of_epipolar_lines() -> None:
    found = judged(faulty("stale_calibration", 702))
    missed = {one.name: one for one in found.criteria if not one.is_met}
    assert "epipolar_residual" in missed
    assert "at most 0.3 px" in missed["epipolar_residual"].sentence


@pytest.mark.whole
def test_a_scan_without_findings_that_misses_a_criterion_is_doubtful() -> None:
    found = judged(healthy(703), DiagnosisLimits((CriteriaLimits(max_noise_ratio=0.1),)))
    assert not found.findings
    assert found.verdict is Verdict.DOUBTFUL
    assert found.reason.startswith("the noise of the coordinate")


@pytest.mark.whole
def test_criteria_are_kept_with_the_verdict(tmp_path: Path) -> None:
    found = judged(healthy(704))
    save_diagnosis(found, tmp_path)
    kept = load_diagnosis(tmp_path)
    assert kept is not None
    assert kept.diagnosis().criteria == found.criteria
