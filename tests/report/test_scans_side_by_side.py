"""Several scans on one page: differences only where calibrations match, verdicts as recorded, names apart."""

from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest

from fpplab.clouds import Cloud
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.geometry import RigidTransform
from fpplab.diagnosis import Diagnosis, Finding, Verdict
from fpplab.diagnosis.causes.flicker import FLICKER
from fpplab.diagnosis.causes.wrong_plan import WRONG_PLAN
from fpplab.diagnosis.record import load_diagnosis, save_diagnosis
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.report.cloud_view import CloudQuantity, cloud_view, decimate
from fpplab.report.parts import ReportTable
from fpplab.report.several_scans import write_scans_report
from fpplab.results.provenance import Provenance, duration_text
from fpplab.results.several_scans import ScanRecord, ScansResult, plan_differences
from fpplab.workflows.report import short_names, subtract_clouds
from tests.comparison.test_comparison import CALIBRATION
from tests.report.test_report import Page, cloud


def record(name: str, points: Cloud | None, rig: str = "one") -> ScanRecord:
    found = Diagnosis(Verdict.DOUBTFUL, "noisy", (Finding(FLICKER, "5 %", 2.0),))
    return ScanRecord(name, Provenance({"rig": rig, "camera": None}), points, CALIBRATION, found, None)


def farther(points: Cloud, mm: float) -> Cloud:
    """Every point farther from the camera along its ray; and one point less."""
    rays = points.points / np.linalg.norm(points.points, axis=1, keepdims=True)
    kept = np.arange(len(points)) > 0
    return replace(points, points=(points.points + mm * rays).astype(np.float32)).only(kept)


def test_a_difference_is_that_along_the_rays() -> None:
    found = subtract_clouds(record("b", farther(cloud(), 0.25)), record("a", cloud()))
    assert found.distances_mm is not None
    assert found.distances_mm == pytest.approx(np.full(len(cloud()) - 1, 0.25), abs=1e-4)
    assert found.summary()["median_um"] == pytest.approx(250, abs=0.1)
    assert found.summary()["pixels"] == len(cloud()) - 1


def test_other_calibrations_and_clouds_without_pixels_are_not_compared() -> None:
    one = record("a", cloud())
    moved = replace(CALIBRATION, T_projector_camera=RigidTransform(np.eye(3), np.array([-99.0, 0, 0])))
    bare = Cloud(cloud().points)
    for other, reason in (
        (replace(one, calibration=moved), "different calibrations"),
        (replace(one, calibration=None), "not recorded"),
        (replace(one, cloud=None), "no points"),
        (replace(one, cloud=bare), "not known by pixels"),
    ):
        assert reason in subtract_clouds(other, one).summary()["not_compared"]


def test_plans_are_compared_by_what_differs() -> None:
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=8, steps=4), Sinusoid(axis="y", stripes=8, steps=3)))
    finer = (Sinusoid(axis="x", stripes=64, steps=4), plan.fringes[1])
    other = plan.model_copy(update={"fringes": finer, "exposure_s": 0.04})
    scans = [replace(record(name, None), plan=one) for name, one in (("a", plan), ("b", other), ("c", None))]
    wanted = {"stripes along x": {"a": "8", "b": "64"}, "exposure_s": {"a": "0.02", "b": "0.04"}}
    assert plan_differences(scans) == wanted
    assert plan_differences([scans[0], scans[0], scans[2]]) == {}


@pytest.mark.whole
def test_the_page_marks_what_differs(tmp_path: Path) -> None:
    scans = [record("a", cloud()), record("b", farther(cloud(), 0.1), rig="two"), record("c", None)]
    plans = (Plan.load("plan_paper"), Plan.load("plan_scan"))
    scans[:2] = [replace(scan, plan=plan) for scan, plan in zip(scans[:2], plans, strict=True)]
    differences = tuple(subtract_clouds(one, scans[0]) for one in scans[1:])
    write_scans_report(tmp_path / "s.html", ScansResult(tuple(scans), differences, tmp_path / "s.html"))
    page = Page(tmp_path / "s.html")
    text = (tmp_path / "s.html").read_text(encoding="utf-8")
    assert text.count('<tr class="marked">') == 1  # the rig; the camera is recorded of none
    assert "not recorded" in page.cells
    assert "images along y" in page.cells
    assert "b minus a" in page.cells
    assert "one of them has no points" in page.cells
    assert text.count('class="verdict doubtful"') == 3
    with pytest.raises(DataError, match="none of 1 sessions holds a cloud"):
        write_scans_report(tmp_path / "t.html", ScansResult(tuple(scans[2:]), (), tmp_path / "t.html"))


def test_names_are_as_short_as_they_may(tmp_path: Path) -> None:
    assert short_names([tmp_path / "a", tmp_path / "b"]) == ["a", "b"]
    assert short_names([tmp_path / "a/cloud.ply", tmp_path / "b/cloud.ply"]) == ["a", "b"]
    with pytest.raises(ConfigError, match="given twice"):
        short_names([tmp_path / "a", tmp_path / "a"])


def test_a_verdict_is_read_back_as_it_was_given(tmp_path: Path) -> None:
    finding = Finding(WRONG_PLAN, "all: 'wrong'\n…", float("inf"), "mend it")
    given = Diagnosis(Verdict.USELESS, "9 points", (finding,), ("focus",))
    assert load_diagnosis(tmp_path) is None
    save_diagnosis(given, tmp_path)
    recorded = load_diagnosis(tmp_path)
    assert recorded is not None
    assert recorded.diagnosis().summary() == given.summary()


def test_decimation_keeps_the_grid_and_the_limit() -> None:
    points = cloud()
    for most in (1, 10, 500, len(points)):
        assert 0 < decimate(points, most).sum() <= most
        assert 0 < decimate(Cloud(points.points), most).sum() <= most
    far = replace(points, points=points.points.copy())
    far.points[7] = 1e6
    assert not decimate(far, len(far))[7]
    assert "1 points far from all others" in cloud_view("far", far).caption


def test_values_are_quantised_within_their_range() -> None:
    values = np.array([-5.0, 0.0, 5.0, np.nan, 1e9], np.float32)
    steps = CloudQuantity("x", "mm", values, -5.0, 5.0, "viridis").quantised()
    assert steps.tolist() == [1, 32768, 65535, 0, 65535]


def test_durations_and_cells() -> None:
    words = [duration_text(timedelta(seconds=s)) for s in (0.25, 61, 3600, 3 * 86400 + 7200)]
    assert words == ["0.2 s", "1 min 1 s", "1 h 0 min", "3 d 2 h"]
    table = ReportTable(("a", "b"), (("=SUM(A1)", "+1\u202f000.5"), ("-x", "-2")))
    import base64

    text = base64.b64decode(table.csv_link.partition(",")[2]).decode("utf-8")
    assert text.splitlines() == ["a,b", "'=SUM(A1),+1000.5", "'-x,-2"]
