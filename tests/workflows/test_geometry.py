"""When a scan's geometry counts as verified: by a board's age, and by what the rig's owner states."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fpplab.calibration.model import Calibration, CalibrationOrigin
from fpplab.core.errors import CalibrationError
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.pipeline.geometry import why_unverified
from fpplab.sessions.origin import calibration_origin, check_stage, with_confirmation
from fpplab.sessions.session import Session
from tests.reconstruction.test_triangulation import CALIBRATION

SCAN = datetime(2026, 3, 1, 12, tzinfo=UTC)
PLAN = Plan(fringes=(Sinusoid(axis="x", stripes=1.0, steps=3),))
RIG: dict[str, Any] = {"name": "bench", "geometry": {"max_age_h": 8.0}}


def session_of(
    folder: Path, rig: dict[str, Any] | None = RIG, taken: datetime = SCAN, plan: Plan = PLAN
) -> Session:
    session = Session.create(folder, plan, rig or {})
    for index, (_, _, pattern) in enumerate(plan.steps()):
        image = np.zeros((12, 16), np.uint8)
        frame = Frame(image, index, CameraSettings(0.02, 0.0, 8), taken.timestamp(), pattern_id=pattern)
        session.write(frame)
    return session


def calibration_of(hours_before: float | None, doubt: str | None = None) -> Calibration:
    taken = None if hours_before is None else SCAN - timedelta(hours=hours_before)
    origin = CalibrationOrigin.now(poses_taken=taken)
    made: Calibration = replace(CALIBRATION, origin=origin, doubt=doubt)
    return made


@pytest.mark.parametrize("hours", [0.0, 7.9, -7.9])
def test_a_board_within_the_stated_hours_verifies(tmp_path: Path, hours: float) -> None:
    assert why_unverified(session_of(tmp_path / "s"), calibration_of(hours)) is None


@pytest.mark.parametrize(
    ("rig", "calibration", "reason"),
    [
        (RIG, calibration_of(8.1), "8.1 h from the scan (at most 8 h)"),
        (RIG, calibration_of(None), "nothing records when the poses of the calibration were taken"),
        (RIG, CALIBRATION, "nothing records when the poses of the calibration were taken"),
        (
            RIG,
            calibration_of(1.0, "the lens was loose"),
            "the calibration was doubtful when it was made",
        ),
        ({"name": "bench"}, calibration_of(1.0), "does not state for how long"),
        (None, calibration_of(1.0), "nothing records when and with which devices"),
    ],
)
def test_what_verifies_nothing_says_why(
    tmp_path: Path, rig: dict[str, Any] | None, calibration: Calibration, reason: str
) -> None:
    doubt = why_unverified(session_of(tmp_path / "s", rig), calibration)
    assert doubt is not None
    assert reason in doubt.reason
    assert bool(doubt.detail) == (calibration.doubt is not None)


def test_a_pose_that_confirms_counts_from_when_it_was_taken(tmp_path: Path) -> None:
    session, old = session_of(tmp_path / "scan"), calibration_of(100.0)
    pose = session_of(tmp_path / "pose", taken=SCAN - timedelta(hours=2))
    confirmed = with_confirmation(old, [pose])
    confirmed.save(tmp_path / "calibration.yaml")
    assert why_unverified(session, Calibration.load(tmp_path / "calibration.yaml")) is None
    with pytest.raises(CalibrationError, match="does not record when it was taken"):
        with_confirmation(old, [pose, session_of(tmp_path / "imported", None)])
    with pytest.raises(CalibrationError, match="does not record when it was made"):
        with_confirmation(CALIBRATION, [pose])


def test_a_stage_that_stood_elsewhere_is_refused_and_one_of_unknown_place_verifies_nothing(
    tmp_path: Path,
) -> None:
    with_stage = RIG | {"stage": {"backend": "grbl"}}
    at_10, at_20 = (PLAN.model_copy(update={"stage_mm": mm}) for mm in (10.0, 20.0))
    poses = [session_of(tmp_path / f"pose_{k}", with_stage, plan=at_10) for k in range(2)]
    origin = calibration_origin(poses)
    assert origin.stage_mm == 10.0
    calibration = replace(CALIBRATION, origin=origin)
    check_stage(calibration, at_10, "plan")
    assert why_unverified(session_of(tmp_path / "same", with_stage, plan=at_10), calibration) is None
    with pytest.raises(CalibrationError, match=r"plan: puts the stage at 20 mm, but .* at 10 mm"):
        check_stage(calibration, at_20, "plan")
    anywhere = session_of(tmp_path / "anywhere", with_stage)
    check_stage(calibration, anywhere.plan, "plan")
    doubt = why_unverified(anywhere, calibration)
    assert doubt is not None
    assert "do not say where the stage stood" in doubt.reason
    mixed = calibration_origin([*poses, anywhere])
    assert mixed.stage_mm is None


@pytest.mark.parametrize(
    ("stated", "reason"),
    [
        ({"settings": {"aperture": 8}, "temperature_c": 22.5}, None),
        ({"settings": {"aperture": 5.6}}, "'aperture' is 5.6 in the rig file, and was 8.0 for the poses"),
        ({}, "'aperture' is not stated in the rig file, and was 8.0 for the poses"),
        ({"settings": {"aperture": 8}, "temperature_c": 23.5}, "23.5 °C, and was at 21 °C"),
    ],
)
def test_settings_and_temperature_are_those_of_the_calibration(
    tmp_path: Path, stated: dict[str, Any], reason: str | None
) -> None:
    def rig(section: dict[str, Any]) -> dict[str, Any]:
        return {"name": "bench", "geometry": {"max_age_h": 8.0, **section}}

    poses = [
        session_of(tmp_path / name, rig({"settings": {"aperture": 8.0}, "temperature_c": 21.0}))
        for name in ("a", "b")
    ]
    known = replace(CALIBRATION, origin=calibration_origin(poses))
    doubt = why_unverified(session_of(tmp_path / "s", rig(stated)), known)
    assert (doubt is None) is (reason is None)
    assert doubt is None or reason in doubt.reason
