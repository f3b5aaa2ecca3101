"""The loop of a guided characterisation on a rig by formulas, whose board a hand holds."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fpplab.core.errors import CalibrationError
from fpplab.core.progress import Progress, no_progress
from fpplab.diagnosis import FaultCause
from fpplab.diagnosis.causes.camera_focus import CAMERA_FOCUS
from fpplab.diagnosis.causes.of_characterisation import BOARD_MOVED, BOARD_NOT_FOUND
from fpplab.diagnosis.causes.saturated import SATURATED
from fpplab.diagnosis.causes.vibration import VIBRATION
from fpplab.setup.guide import GuidedRun, GuidedSettings, guided_characterisation
from tests.support.hand_held import PLAN, hand_held_rig
from tests.support.plane_twin import TARGET

FAULTS = {4: "moved", 6: "defocused"}
"""By the number of the attempt."""


@contextmanager
def bar(what: str) -> Iterator[Progress]:
    yield no_progress


def guided(
    folder: Path, settings: GuidedSettings, faults: dict[int, str] | None = None, seed: int = 0
) -> tuple[GuidedRun, list[str]]:
    said: list[str] = []
    with hand_held_rig(faults, seed) as rig:
        return guided_characterisation(rig, PLAN, TARGET, folder, settings, said.append, bar), said


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[GuidedRun, list[str], Path]:
    """Seven poses at most, of which the fifth attempt moves and the seventh is out of focus."""
    folder = tmp_path_factory.mktemp("guided")
    settings = GuidedSettings(poses=7, until_mm=1e-5, level="auto")
    return *guided(folder, settings, FAULTS), folder


@pytest.mark.nightly
def test_bad_poses_are_rejected_with_their_cause_and_the_loop_goes_on(
    run: tuple[GuidedRun, list[str], Path],
) -> None:
    found, said, folder = run
    assert [k for k, one in enumerate(found.attempts) if not one.accepted] == [4, 6]
    moved, blurred = found.attempts[4], found.attempts[6]
    assert moved.findings[0].cause in (VIBRATION, BOARD_MOVED)
    assert blurred.findings[0].cause == CAMERA_FOCUS
    assert [line for line in said if "rejected" in line and CAMERA_FOCUS.remedy in line]
    assert len(found.sessions) == len(found.result.observations) == 7
    assert sorted(p.name for p in (folder / "rejected").iterdir()) == ["pose_04_1", "pose_05_1"]
    assert not [w for w in found.result.warnings if "moved" in w]


@pytest.mark.whole
def test_every_pose_lessens_the_uncertainty_and_residuals_are_as_predicted(
    run: tuple[GuidedRun, list[str], Path],
) -> None:
    found, _, _ = run
    accepted = [one for one in found.attempts if one.accepted]
    forms = [one.form_mm for one in accepted[2:]]
    assert all(form is not None for form in forms)
    assert forms[-1] < 0.5 * forms[0]  # type: ignore[operator]
    for one in accepted[3:]:
        assert one.fit is not None
        assert one.rms_px["projector"] < 2.0 * one.fit.projector.predicted_px
    assert all(one.rms_px for one in accepted)


@pytest.mark.whole
def test_what_was_asked_for_and_not_reached_is_said(run: tuple[GuidedRun, list[str], Path]) -> None:
    found, said, _ = run
    assert not found.reached
    assert "0.01 µm were asked for" in said[-1]
    assert found.summary()["reached"] is False
    assert (run[2] / "next_pose.png").stat().st_size > 2000


@pytest.mark.whole
def test_poses_on_disk_are_kept_and_count(run: tuple[GuidedRun, list[str], Path]) -> None:
    """The same command again takes nothing; one pose more is taken where more are allowed."""
    found, _, folder = run
    journals = {p: p.read_bytes() for p in folder.glob("pose_*/journal.jsonl")}
    again, said = guided(folder, GuidedSettings(poses=7), FAULTS)
    assert not [line for line in said if line.startswith("pose") and "tilted" in line]
    assert {p: p.read_bytes() for p in folder.glob("pose_*/journal.jsonl")} == journals
    assert again.form_mm == pytest.approx(found.form_mm, rel=0.02)


@pytest.mark.whole
def test_the_loop_ends_when_enough_is_known(tmp_path: Path) -> None:
    found, said = guided(tmp_path, GuidedSettings(poses=12, until_mm=0.2), seed=3)
    assert found.reached
    assert 5 <= len(found.sessions) < 12
    assert found.form_mm <= 0.2
    assert "-> 200 µm" in said[-2] or "-> 200 µm" in " ".join(said)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("fault", "cause"),
    [("hidden", BOARD_NOT_FOUND), ("saturated", SATURATED)],
)
def test_other_bad_poses_are_named(tmp_path: Path, fault: str, cause: FaultCause) -> None:
    found, _ = guided(tmp_path, GuidedSettings(poses=5), {1: fault, 4: fault}, seed=5)
    bad = [k for k, one in enumerate(found.attempts) if not one.accepted]
    assert bad == [1, 4]
    for k in bad:
        assert cause in {one.cause for one in found.attempts[k].findings}


@pytest.mark.nightly
def test_a_board_that_is_never_found_ends_the_loop(tmp_path: Path) -> None:
    with pytest.raises(CalibrationError, match=r"3 poses in succession were rejected.*not found"):
        guided(tmp_path, GuidedSettings(poses=5), dict.fromkeys(range(9), "hidden"))
