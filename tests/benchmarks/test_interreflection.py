"""The groove of the benchmark of light between walls, and what is said of a scan of it."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.interreflection import DEPTH_MM, Groove, measured_flatness, scanned_groove, usual_plans
from fpplab.clouds import Cloud
from fpplab.core.progress import no_progress
from fpplab.diagnosis.causes.interreflection import COAT, offer
from fpplab.diagnosis.evidence import Evidence
from fpplab.phase.fine_plan import fine_plan
from fpplab.pipeline.measuring import triangulate_recording


def test_view_factors_add_up_to_that_of_the_whole_wall() -> None:
    groove = Groove()
    edges = groove.wall_mm * np.linspace(0.0, 1.0, 801) ** 2
    middles = 0.5 * (edges[1:] + edges[:-1])
    expected = 0.5 * (1.0 - middles / np.hypot(middles, groove.wall_mm))
    np.testing.assert_allclose(groove.view_factors(edges).sum(axis=1)[50:], expected[50:], atol=1e-3)


def test_bounces_add_light_where_the_walls_meet() -> None:
    plan = usual_plans()["plan_paper"]
    lit, alone = Groove().levels(plan)[0], Groove(bounces=0).levels(plan)[0]
    ratio = lit[700:900] / np.maximum(alone[700:900], 1e-6)
    assert ratio[0] > 1.2
    assert ratio[0] > ratio[-1] > 1.0


@pytest.mark.whole
def test_the_plan_offered_makes_the_walls_flatter() -> None:
    groove = Groove(reflectance=0.7, seed=4)
    plans = usual_plans()["plan_paper"], fine_plan(groove.calibration, DEPTH_MM)
    usual, fine = (measured_flatness(groove, scanned_groove(groove, plan)[0]) for plan in plans)
    assert (usual.flat_um / fine.flat_um > 5.0).all()
    assert usual.over_stated > 2.0
    assert fine.over_stated < 1.25


@pytest.mark.whole
def test_weak_light_is_told_where_it_costs_more_than_is_stated() -> None:
    groove = Groove(reflectance=0.15, angle_deg=75.0, seed=5)
    cloud, diagnosis = scanned_groove(groove, usual_plans()["plan_scan"])
    (finding,) = diagnosis.findings
    assert finding.cause.key == "interreflection"
    assert "wide and fine fringes contradict each other beyond noise" in finding.evidence
    assert " µm, beside " in finding.evidence
    true = measured_flatness(groove, cloud).over_stated
    assert np.hypot(1.0, finding.excess) == pytest.approx(true, rel=0.3)
    dark = replace(groove, bounces=0)
    assert not scanned_groove(dark, usual_plans()["plan_scan"])[1].findings


@pytest.mark.whole
def test_the_finding_offers_the_plan_unless_it_was_used() -> None:
    groove = Groove(seed=4)
    _, diagnosis = scanned_groove(groove, usual_plans()["plan_paper"])
    assert diagnosis.verdict.value in ("doubtful", "useless")
    (finding,) = diagnosis.findings
    assert finding.cause.key == "interreflection"
    assert "36 images are expected to leave 1/7 of the error" in finding.remedy
    assert "`fpplab plan fine --depth 436 475 --calibration FILE --out fine.yaml`" in finding.remedy
    fine = groove.recording(fine_plan(groove.calibration, DEPTH_MM))
    decoded, cloud = triangulate_recording(fine, groove.calibration, None, no_progress)
    assert isinstance(cloud, Cloud)
    assert offer(Evidence(fine, decoded, cloud, groove.calibration)) == COAT
