"""The check of a rig names what is wrong with it, from the marker and a few fringes."""

from dataclasses import replace
from typing import Any

import pytest

from fpplab.calibration.model import Calibration
from fpplab.core.errors import CalibrationError, CapabilityError
from fpplab.patterns.fringes import Pattern
from fpplab.patterns.plan import Plan
from fpplab.setup.rig_check.check import RigCheck, check_rig
from tests.support.faulty_bench import FAULTS, PLANS
from tests.support.faulty_rig import FormulaProjector, drawn, formula_rig


def checked(cause: str | None, seed: int) -> RigCheck:
    bench = drawn(cause, seed)
    return check_rig(formula_rig(cause, seed), bench.plan, "card", lambda _: None, bench.calibration)


HAVE_EFFECTS = {"bands", "interreflection"}
"""Bands change the brightness of whole frames too, and light between surfaces bends fringes."""


def causes(found: RigCheck) -> list[str]:
    return [finding.cause.key for finding in found.findings]


def with_plan(plan: Plan, calibration: Calibration | None, cause: str | None = None) -> RigCheck:
    return check_rig(formula_rig(cause, 6), plan, "card", lambda _: None, calibration)


@pytest.mark.whole
@pytest.mark.parametrize("cause", ["projector_focus", "flicker", "response"])
def test_the_cause_is_named_first(cause: str) -> None:
    assert causes(checked(cause, 2))[0] == cause


@pytest.mark.whole
def test_all_is_well_with_a_good_rig() -> None:
    found = checked(None, 3)
    assert found.summary()["ok"]
    assert found.unknown == ()
    assert found.recording is not None


@pytest.mark.nightly
@pytest.mark.parametrize("cause", [cause for cause in FAULTS if cause != "wrong_plan"])  # a recording's
def test_every_cause_is_named_first_at_other_strengths(cause: str) -> None:
    found = causes(checked(cause, 4))
    assert cause in found[: 2 if cause in HAVE_EFFECTS else 1]


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(8, 11))
def test_other_good_rigs_are_left_in_peace(seed: int) -> None:
    assert causes(checked(None, seed)) == []


@pytest.mark.whole
def test_a_stale_calibration_is_found_though_the_plan_has_one_axis() -> None:
    bench = drawn("stale_calibration", 6)
    found = with_plan(PLANS["three"], bench.calibration, "stale_calibration")
    assert causes(found) == ["stale_calibration"]
    assert [unknown.split(":")[0] for unknown in found.unknown] == ["projector_drift", "motion"]


@pytest.mark.whole
def test_without_a_calibration_the_check_says_what_it_cannot_tell() -> None:
    found = with_plan(PLANS["three"], None)
    assert causes(found) == []
    assert "stale_calibration" in found.unknown[0]


def holding(monkeypatch: pytest.MonkeyPatch, axes: str) -> None:
    """Let the projector hold patterns along these axes alone, beside uniform ones."""
    load = FormulaProjector.load

    def held(projector: FormulaProjector, patterns: list[Pattern], *rest: Any) -> None:
        if any(pattern.id[2:5] in {"-x-", "-y-"} and pattern.id[3] not in axes for pattern in patterns):
            raise CapabilityError("projector", "load", "the plan is not in flash", "upload it")
        load(projector, patterns, *rest)

    monkeypatch.setattr(FormulaProjector, "load", held)


@pytest.mark.whole
def test_fringes_along_one_axis_serve_where_the_others_are_not_in_flash(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    holding(monkeypatch, "x")
    found = with_plan(PLANS["three"], drawn(None, 6).calibration)
    assert causes(found) == []
    assert any("stale_calibration" in words for words in found.unknown)


def test_fringes_that_are_not_in_flash_are_not_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    holding(monkeypatch, "")
    found = with_plan(PLANS["three"], drawn(None, 6).calibration)
    assert found.findings == ()
    assert found.recording is None
    assert found.unknown == ("light, focus and geometry: the plan is not in flash; upload it",)


def test_a_calibration_of_another_camera_is_refused_before_anything_is_shown(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(FormulaProjector, "load", lambda *_: pytest.fail("patterns were loaded"))
    known = drawn(None, 6).calibration
    other = replace(known, camera=replace(known.camera, size=(640, 480)))
    with pytest.raises(CalibrationError, match="640"):
        with_plan(PLANS["three"], other)
