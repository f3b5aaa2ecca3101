"""`reconstruct` says whether to believe its result, and writes nothing that is useless."""

from pathlib import Path

import pytest
from rich.console import Console

from fpplab.cli import console
from fpplab.devices import CameraSettings, Frame
from fpplab.sessions.session import Session
from tests.support.commands import Command, Outcome
from tests.support.faulty_bench import Bench, faulty, healthy


def recorded(bench: Bench, folder: Path) -> None:
    """Leave the frames of a bench as a session, and its calibration beside it."""
    recording = bench.recording()
    rig = {"resolved": {"projector": {"size": list(recording.projector_size), "lattice": "square"}}}
    session = Session.create(folder / "session", bench.plan, rig)
    for index, ((_, _, pattern), image) in enumerate(zip(bench.plan.steps(), recording.frames, strict=True)):
        session.write(Frame(image, index, CameraSettings(0.02, 0.0, bench.bits), 0.0, pattern_id=pattern))
    bench.calibration.save(folder / "calibration.yaml")


def reconstructed(fpplab: Command, bench: Bench, folder: Path, *options: str | Path) -> Outcome:
    """Record a bench, and reconstruct it by command."""
    recorded(bench, folder)
    words = "--calibration", folder / "calibration.yaml", "--out", folder / "cloud.ply"
    return fpplab("reconstruct", folder / "session", *words, *options, "--json")


@pytest.mark.whole
def test_a_session_that_records_no_devices_is_unverified(fpplab: Command, tmp_path: Path) -> None:
    done = reconstructed(fpplab, healthy(101), tmp_path)
    assert done.code == 0, done.err
    assert done.json["verdict"] == "unverified"
    assert done.json["findings"] == []
    assert (tmp_path / "cloud.ply").is_file()
    assert 'class="verdict unverified"' in (tmp_path / "cloud.html").read_text()


def test_a_useless_result_is_not_written(fpplab: Command, tmp_path: Path) -> None:
    done = reconstructed(fpplab, faulty("projector_focus", 101), tmp_path)
    assert done.code == 4, done.err
    assert done.json["verdict"] == "useless"
    assert done.json["exit_code"] == 4
    first = done.json["findings"][0]
    assert first["cause"] == "projector_focus"
    assert first["evidence"] in done.err
    assert first["remedy"] in done.err
    assert not (tmp_path / "cloud.ply").exists()
    page = (tmp_path / "cloud.html").read_text()  # without a single point, but with what shows it and a frame
    assert 'class="verdict useless"' in page
    assert "projector focus" in page
    assert page.count("<img") == len(done.json["findings"]) + 1


@pytest.mark.whole
def test_a_doubtful_result_is_told_first(fpplab: Command, tmp_path: Path) -> None:
    done = reconstructed(fpplab, faulty("ambient", 101), tmp_path)
    assert done.code == 0, done.err
    assert done.json["verdict"] == "doubtful"
    assert done.json["findings"][0]["cause"] == "ambient"
    assert "verdict: doubtful: ambient: " in done.err
    assert 'class="verdict doubtful"' in (tmp_path / "cloud.html").read_text()


@pytest.mark.whole
def test_limits_of_an_expert_are_used_and_said(fpplab: Command, tmp_path: Path) -> None:
    limits = tmp_path / "limits_bright_room.yaml"
    limits.write_text("ambient:\n  max_ratio: 9.0\n")
    done = reconstructed(fpplab, faulty("ambient", 101), tmp_path, "--limits", limits)
    assert done.code == 0, done.err
    assert "ambient" not in [one["cause"] for one in done.json["findings"]]
    assert done.json["limits"] == {"ambient": {"max_ratio": 9.0}}
    limits.write_text("ambient:\n  most: 9.0\n")
    options = ("--calibration", tmp_path / "calibration.yaml", "--out", tmp_path / "again.ply")
    refused = fpplab("reconstruct", tmp_path / "session", *options, "--limits", limits)
    assert refused.code == 2
    assert "ambient: unknown key 'most'" in refused.err


@pytest.mark.parametrize("in_terminal", [True, False])
def test_a_terminal_shows_a_verdict_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], in_terminal: bool
) -> None:
    monkeypatch.setattr(console, "stdout", Console(force_terminal=in_terminal, highlight=False))
    console.log_verdict("verdict: good: nothing is wrong")
    console.print_result({"verdict": "good"}, as_json=False)
    shown = capsys.readouterr()
    assert shown.out == "verdict: good\n"
    assert shown.err == ("" if in_terminal else "verdict: good: nothing is wrong\n")
