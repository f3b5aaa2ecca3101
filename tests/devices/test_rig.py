"""Rig files: what they open, and what they refuse."""

import os
import signal
from pathlib import Path

import pytest

from fpplab.core import interrupts
from fpplab.core.errors import ConfigError, DeviceError
from fpplab.devices import State
from fpplab.devices.rig import Rig
from tests.conformance import reference
from tests.conformance.reference import ReferenceBench, ReferenceProjector

GOOD = """
name: test
bench: {backend: "tests.conformance.reference:ReferenceBench"}
camera: {backend: "tests.conformance.reference:ReferenceCamera", bits: 12, gain_db: 3}
projector: {backend: "tests.conformance.reference:ReferenceProjector"}
stage: {backend: "tests.conformance.reference:ReferenceStage"}
"""


def rig_of(text: str, tmp_path: Path) -> Rig:
    path = tmp_path / "rig.yaml"
    path.write_text(text)
    return Rig.load(path)


def test_a_rig_opens_what_its_file_names_and_closes_it(tmp_path: Path) -> None:
    with rig_of(GOOD, tmp_path) as rig:
        devices = [rig.camera, rig.projector, rig.stage]
        assert [d.state for d in devices if d] == [State.IDLE] * 3
        assert [d.name for d in devices if d] == ["camera", "projector", "stage"]
        assert rig.fixture is None
        settings = rig.camera_settings(0.05)
        assert (settings.exposure_s, settings.gain_db, settings.bits) == (0.05, 3.0, 12)
    assert [d.state for d in devices if d] == [State.CLOSED] * 3


def test_notes_are_told_each_time_the_rig_is_opened(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rig = rig_of(GOOD + "notes: ['lens_not_locked accepted: pose_02']\n", tmp_path)
    assert not caplog.records
    for times in (1, 2):
        with rig:
            pass
        told = [r.getMessage() for r in caplog.records if r.levelname == "WARNING"]
        assert told == times * [f"{tmp_path / 'rig.yaml'}: lens_not_locked accepted: pose_02"]


def test_a_plan_s_depth_goes_before_the_rig_s_and_must_be_offered(tmp_path: Path) -> None:
    with rig_of(GOOD, tmp_path) as rig:
        offered = rig.camera.caps.bits
        assert [rig.camera_settings(0.05, bits).bits for bits in offered] == list(offered)
        with pytest.raises(ConfigError, match="'bits' is 16, but camera of test offers 8, 12"):
            rig.camera_settings(0.05, 16)


def test_a_rig_file_may_name_its_response(tmp_path: Path) -> None:
    with rig_of(GOOD + "response: {a: 0.65, b: 0.05, g: 1.1}\n", tmp_path) as rig:
        assert rig.described()["response"] == {"a": 0.65, "b": 0.05, "g": 1.1}
    with pytest.raises(ConfigError, match="'response' must name a file written by"):
        rig_of(GOOD + "response: nothing.yaml\n", tmp_path)


def test_it_tells_a_session_what_it_is(tmp_path: Path) -> None:
    with rig_of(GOOD, tmp_path) as rig:
        described = rig.described()
    assert described["resolved"] == {
        "camera": {"model": "reference", "size": [48, 32]},
        "projector": {"model": "reference", "size": [24, 16], "lattice": "diamond"},
    }
    assert described["camera"]["bits"] == 12
    assert "fixture" not in described
    assert "depth_mm" not in described


def test_it_states_where_everything_lies(tmp_path: Path) -> None:
    with rig_of(GOOD + "depth_mm: [380, 480]\n", tmp_path) as rig:
        assert rig.file.depth_mm == (380.0, 480.0)
        assert rig.described()["depth_mm"] == [380.0, 480.0]


@pytest.mark.parametrize(
    ("old", "new", "complaint"),
    [
        ("name: test", "", "'name' is missing"),
        ("name: test", "name: test\nlaser: {}", "unknown key 'laser'"),
        (
            "name: test",
            "name: test\ndepth_mm: [480, 380]",
            r"'depth_mm' is \[480, 380\]: the first must be less",
        ),
        ("name: test", "name: test\ndepth_mm: [-1, 380]", r"'depth_mm\[0\]' is -1: should be greater than 0"),
        ("bits: 12", "bits: 11", "'camera.bits' is 11: should be 8, 10, 12 or 16"),
        ("bits: 12", "bits: '12'", "'camera.bits' is '12'"),
        ("reference:ReferenceStage", "reference.ReferenceStage", "'stage.backend' is 'tests"),
        ("reference:ReferenceStage", "reference:Nothing", "'stage.backend' is .* has no Nothing"),
        ("reference:ReferenceStage", "nowhere:Stage", r"'stage.backend' is .* cannot be loaded \(No module"),
        ("reference:ReferenceStage", "reference:ReferenceCamera", "'stage.backend' is .*: not a stage"),
        ("reference:ReferenceStage", "reference:replace", "'stage.backend' is .*: not a stage"),
        ('ReferenceStage"}', 'ReferenceStage", speed: 3}', "'stage' has no option 'speed'"),
    ],
)
def test_a_wrong_file_is_refused(tmp_path: Path, old: str, new: str, complaint: str) -> None:
    assert GOOD.count(old) == 1
    with (
        pytest.raises(ConfigError, match=rf"rig\.yaml: {complaint}"),
        rig_of(GOOD.replace(old, new), tmp_path),
    ):
        pass


def test_a_device_that_does_not_open_closes_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    closed: list[str] = []
    for name in ("ReferenceBench.close", "ReferenceCamera._close", "ReferenceProjector._close"):
        monkeypatch.setattr(f"{reference.__name__}.{name}", lambda self, name=name: closed.append(name))

    def broken(self: object) -> None:
        raise OSError("no answer")

    monkeypatch.setattr(reference.ReferenceStage, "_open", broken)
    with pytest.raises(DeviceError, match="stage: open: OSError: no answer"), rig_of(GOOD, tmp_path):
        pass
    assert closed == ["ReferenceProjector._close", "ReferenceCamera._close", "ReferenceBench.close"]


def test_a_device_that_cannot_be_made_safe_does_not_keep_the_others_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(self: object) -> None:
        raise OSError("stuck")

    monkeypatch.setattr(reference.ReferenceProjector, "_close", broken)
    rig = rig_of(GOOD, tmp_path)
    with pytest.raises(DeviceError, match="projector: close: OSError: stuck"), rig:
        assert rig.camera.state is State.IDLE
    assert str(rig.camera.state) == str(rig.projector.state) == "closed"


def test_an_interruption_while_it_closes_waits_until_all_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = {number: signal.getsignal(number) for number in interrupts.SIGNALS}
    monkeypatch.setattr(interrupts, "_interrupted", [])
    close, made_dark = ReferenceProjector._close, list[str]()

    def interrupted(projector: ReferenceProjector) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        close(projector)
        made_dark.append(projector.name)

    monkeypatch.setattr(ReferenceProjector, "_close", interrupted)
    interrupts.watch_signals()
    try:
        with pytest.raises(KeyboardInterrupt), rig_of(GOOD, tmp_path):
            assert made_dark == []
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert made_dark == ["projector"]


def test_files_are_looked_for_beside_the_rig_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []
    monkeypatch.setattr(ReferenceBench, "open", lambda self: seen.append(self.options["world"]))
    monkeypatch.setattr(ReferenceBench, "close", lambda self: None)
    (tmp_path / "here.yaml").write_text("")
    for name in ("here.yaml", "elsewhere.yaml"):
        text = GOOD.replace('ReferenceBench"', f'ReferenceBench", world: {name}')
        rig = rig_of(text, tmp_path)
        monkeypatch.setattr(reference.ReferenceProjector, "_close", lambda self: None)
        monkeypatch.setattr(reference.ReferenceCamera, "_close", lambda self: None)
        with rig:
            pass
    assert seen == [str((tmp_path / "here.yaml").resolve()), "elsewhere.yaml"]
