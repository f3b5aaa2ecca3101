"""Benches whose timing slips: noticed and named before anything is computed, by whole commands too."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import Result
from typer.testing import CliRunner

from fpplab.acquisition import acquire as acquisition
from fpplab.acquisition.acquire import acquire, capture
from fpplab.acquisition.synchronisation import Cause, SyncFault
from fpplab.calibration.model import Calibration
from fpplab.cli.console import CommandExit
from fpplab.cli.every import app
from fpplab.core import config
from fpplab.core.conventions import Lattice
from fpplab.core.errors import CalibrationError, DataError, DeviceError, FppError, SyncError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.core.session_names import CLOUD, DECODED, REPORT
from fpplab.devices.rig import Rig, RigFile
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.pipeline.characterising import characterise_sessions
from fpplab.sessions.session import Session
from fpplab.setup.rig_check.marker_check import LIMITS as MARKER_LIMITS
from fpplab.targets import Target
from tests.conformance.reference import CAMERA_SIZE, PROJECTOR_SIZE
from tests.conformance.slipping import CLOCK

FRINGES = (
    Sinusoid(axis="x", stripes=1, steps=6),
    Sinusoid(axis="x", stripes=3, steps=8),
    Sinusoid(axis="y", stripes=1, steps=6),
)
COARSE = (Sinusoid(axis="x", stripes=1, steps=3),)
LATENCY_S = 0.015
"""Of a display; shorter than the exposure, so that each frame shows the pattern before."""
SLIPS = [
    SyncFault(Cause.LATE),
    SyncFault(Cause.EARLY),
    SyncFault(Cause.MISSED, 8),
    SyncFault(Cause.DOUBLED, 9),
]


def rig(**slip: Any) -> dict[str, Any]:
    here = "tests.conformance"
    return {
        "name": "Reference rig whose timing slips",
        "bench": {"backend": f"{here}.slipping:SlippingBench", **slip},
        "camera": {"backend": f"{here}.slipping:BlindCamera"},
        "projector": {"backend": f"{here}.slipping:SlippingProjector"},
    }


def slipping(fault: SyncFault | None) -> dict[str, Any]:
    return rig(cause=fault.cause.value, frame=fault.frame) if fault else rig()


def opened(described: dict[str, Any]) -> Rig:
    return Rig(RigFile(**described), Path(), "rig.yaml")


def plan(trigger: str, settle_s: float = 0.0, fringes: tuple[Sinusoid, ...] = FRINGES) -> Plan:
    return Plan(fringes=fringes, trigger=trigger, settle_s=settle_s)  # type: ignore[arg-type]


def taken(described: dict[str, Any], wanted: Plan, path: Path) -> Session:
    with opened(described) as bench:
        session = Session.create(path, wanted, bench.described())
        acquire(bench, wanted, session)
    return session


@pytest.fixture(autouse=True)
def _quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Settling times pass on the bench's clock."""
    monkeypatch.setattr(acquisition, "time", CLOCK)


# Acquisition


@pytest.mark.parametrize("fault", SLIPS, ids=lambda f: f.cause)
def test_a_trigger_that_slips_is_named_and_the_frames_stay(fault: SyncFault, tmp_path: Path) -> None:
    with pytest.raises(SyncError) as told:
        taken(slipping(fault), plan("triggered"), tmp_path / "s")
    assert fault.describe() in str(told.value)
    assert "cable" in str(told.value)
    assert "--force" in str(told.value)
    assert Session.open(tmp_path / "s").missing() == []


def test_a_display_that_is_slower_than_the_plan_waits_is_named(tmp_path: Path) -> None:
    with pytest.raises(SyncError) as told:
        taken(rig(latency_s=LATENCY_S), plan("stepped"), tmp_path / "short")
    assert SyncFault(Cause.LATE).describe() in str(told.value)
    assert "longer settle_s" in str(told.value)
    taken(rig(latency_s=LATENCY_S), plan("stepped", settle_s=LATENCY_S), tmp_path / "long")


@pytest.mark.parametrize("fringes", [FRINGES, COARSE], ids=["proven by frames", "proven by a marker"])
@pytest.mark.parametrize("trigger", ["stepped", "triggered"])
def test_what_is_in_step_is_taken(trigger: str, fringes: tuple[Sinusoid, ...], tmp_path: Path) -> None:
    session = taken(rig(), plan(trigger, fringes=fringes), tmp_path / "s")
    assert session.missing() == []


@pytest.mark.parametrize(
    "fault",
    [SyncFault(Cause.LATE), SyncFault(Cause.EARLY), SyncFault(Cause.MISSED, 1), SyncFault(Cause.DOUBLED, 2)],
    ids=lambda f: f.cause,
)
def test_frames_that_cannot_prove_themselves_are_followed_by_a_marker(
    fault: SyncFault, tmp_path: Path
) -> None:
    with pytest.raises(SyncError, match="no black and then white image"):
        taken(slipping(fault), plan("triggered", fringes=COARSE), tmp_path / "s")


@pytest.mark.parametrize("fringes", [FRINGES, COARSE], ids=["proven by frames", "proven by a marker"])
@pytest.mark.parametrize("trigger", ["stepped", "triggered"])
def test_what_is_captured_in_memory_is_what_a_session_holds(
    trigger: str, fringes: tuple[Sinusoid, ...], tmp_path: Path
) -> None:
    wanted = plan(trigger, fringes=fringes)
    with opened(rig()) as bench:
        frames = capture(bench, wanted)
    session = taken(rig(), wanted, tmp_path / "s")
    np.testing.assert_array_equal(np.stack(frames), np.stack(session.stack()))


@pytest.mark.parametrize(
    ("fringes", "fault"), [(FRINGES, SyncFault(Cause.DOUBLED, 9)), (COARSE, SyncFault(Cause.MISSED, 1))]
)
def test_what_slips_is_not_captured_either(fringes: tuple[Sinusoid, ...], fault: SyncFault) -> None:
    with opened(slipping(fault)) as bench, pytest.raises(SyncError, match="cable"):
        capture(bench, plan("triggered", fringes=fringes))


def test_the_rest_of_an_interrupted_session_is_looked_at_with_what_was_there(tmp_path: Path) -> None:
    wanted = plan("triggered")
    whole = taken(rig(), wanted, tmp_path / "whole")
    with opened(slipping(SyncFault(Cause.LATE))) as bench:
        session = Session.create(tmp_path / "s", wanted, bench.described())
        journal = (whole.path / "journal.jsonl").read_text().splitlines(keepends=True)[:8]
        for k, line in enumerate(journal):
            record = whole.record(k)
            (session.path / record.file).parent.mkdir(exist_ok=True)
            (session.path / record.file).write_bytes((whole.path / record.file).read_bytes())
            with (session.path / "journal.jsonl").open("a") as stream:
                stream.write(line)
        with pytest.raises(SyncError):
            acquire(bench, wanted, Session.open(session.path))


# Whole commands


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Calibration and plans."""
    camera = Pinhole.from_focal(CAMERA_SIZE, (60.0, 60.0), (23.5, 15.5))
    projector = Pinhole.from_focal(PROJECTOR_SIZE, (30.0, 60.0), (11.5, 7.5), lattice=Lattice.DIAMOND)
    pose = RigidTransform.from_vectors(np.array([0.0, 0.2, 0.0]), np.array([-60.0, 0.0, 0.0]))
    Calibration(camera, projector, pose, {}).save(tmp_path / "calibration.yaml")
    for trigger in ("stepped", "triggered"):
        (tmp_path / f"{trigger}.yaml").write_text(config.dump(plan(trigger)))
    return tmp_path


def fpplab(*words: object) -> Result:
    return CliRunner().invoke(app, [str(w) for w in words])


def described_in(folder: Path, described: dict[str, Any]) -> Path:
    path = folder / "rig.yaml"
    path.write_text(config.to_yaml(described))
    return path


@pytest.mark.parametrize(
    ("trigger", "slip"),
    [("stepped", {"latency_s": LATENCY_S}), ("triggered", {"cause": "doubled", "frame": 9})],
)
def test_a_scan_out_of_step_leaves_no_cloud(folder: Path, trigger: str, slip: dict[str, Any]) -> None:
    out = folder / "scan"
    words = ["scan", "--rig", described_in(folder, rig(**slip)), "--plan", folder / f"{trigger}.yaml",
             "--calibration", folder / "calibration.yaml", "--out", out, "--json"]  # fmt: skip
    assert isinstance(fpplab(*words).exception, SyncError)
    assert Session.open(out).missing() == []
    # What is recorded is refused by every command that computes from it, and so is finishing the scan.
    again = [
        words,
        ["decode", out, "--out", folder / "d.npz"],
        ["reconstruct", out, "--calibration", folder / "calibration.yaml", "--out", folder / "c.ply"],
    ]
    for command in again:
        refused = fpplab(*command).exception
        assert isinstance(refused, DataError)
        assert "shows" in str(refused)
        assert "--force" in str(refused)
    assert not any((out / name).exists() for name in (CLOUD, DECODED, REPORT))
    with pytest.raises(CalibrationError, match="take this pose again"):
        characterise_sessions([Session.open(out)] * 3, Target.load("target_paper"))


def checked(
    folder: Path, described: dict[str, Any], *words: object, name: str = "triggered"
) -> dict[str, Any]:
    command = ["check", "--rig", described_in(folder, described), "--plan", folder / f"{name}.yaml", "--json"]
    done = fpplab(*command, *words)
    answer: dict[str, Any] = json.loads(done.stdout[done.stdout.index("{") :])
    assert answer["ok"] is not bool(answer["findings"])
    assert done.exit_code == (0 if answer["ok"] else DeviceError.exit_code)
    assert answer["ok"] or not isinstance(done.exception, FppError)
    return answer


@pytest.fixture(autouse=True)
def disk_that_is_fast_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    """How fast a busy computer writes is no part of these tests."""
    monkeypatch.setattr("fpplab.setup.rig_check.check.disk_finding", lambda *_: None)


def test_a_sound_bench_passes(folder: Path) -> None:
    found = checked(folder, rig(), "--out", folder / "check.png")
    assert found["ok"]
    assert set(found["seen"]) == {"stepped", "triggered"}
    assert len(found["shown"]) == 12
    assert (folder / "check.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("fault", SLIPS, ids=lambda f: f.cause)
def test_the_check_names_a_trigger_that_slips(folder: Path, fault: SyncFault) -> None:
    (finding,) = checked(folder, slipping(fault))["findings"]
    assert finding["cause"] == "out_of_step"
    assert finding["evidence"] == f"triggered: {fault.describe()}"
    assert "cable" in finding["remedy"]


def test_the_check_measures_the_latency_of_the_display(folder: Path) -> None:
    found = checked(folder, rig(latency_s=LATENCY_S))
    assert found["settle_s"] == min(s for s in MARKER_LIMITS.settle_s if s > LATENCY_S)
    (finding,) = found["findings"]
    assert finding["cause"] == "slow_display"
    assert finding["remedy"] == f"put `settle_s: {found['settle_s']:g}` into the plan"


@pytest.mark.parametrize(("exposure_s", "cause"), [(0.0005, "underexposed"), (0.05, "saturated")])
def test_the_check_names_too_little_and_too_much_light(folder: Path, exposure_s: float, cause: str) -> None:
    dim = plan("stepped").model_copy(update={"exposure_s": exposure_s})
    (folder / "dim.yaml").write_text(config.dump(dim))
    (finding,) = checked(folder, rig(), name="dim")["findings"]
    assert finding["cause"] == cause


def test_a_device_that_does_not_open_is_a_finding(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(self: object) -> None:
        raise DeviceError("camera", "open", "is not connected", "see to its cable")

    monkeypatch.setattr("tests.conformance.slipping.BlindCamera._open", gone)
    (finding,) = checked(folder, rig())["findings"]
    assert finding["cause"] == "device"
    assert finding["evidence"] == "camera: open: is not connected (DeviceError)"
    assert finding["remedy"] == "see to its cable"


def test_an_answer_with_findings_is_given_once() -> None:
    assert CommandExit(3).code == 3
