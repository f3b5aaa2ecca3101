"""Python and the command line give the same results and leave the same files."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from fpplab import Calibration, Plan, Rig, ScanResult, Session, reconstruct, scan
from fpplab.core.errors import DataError
from fpplab.diagnosis import UselessScanError
from tests.cli.test_verdict import recorded
from tests.support.commands import Command
from tests.support.faulty_bench import faulty, healthy

OWN = {"seconds", "provenance", "cloud", "report"}
"""What is not the same for two runs: times and places."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recorded session, its calibration, and a rig that replays it."""
    folder = tmp_path_factory.mktemp("bench")
    recorded(healthy(101), folder)
    rig = {
        "name": "replay",
        "bench": {"backend": "fpplab.sessions.replay:RecordedSession", "session": str(folder / "session")},
        "camera": {"backend": "fpplab.sessions.replay:ReplayCamera", "bits": 12},
        "projector": {"backend": "fpplab.sessions.replay:ReplayProjector"},
    }
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig))
    return folder


def common(answer: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in answer.items() if key not in OWN}


def files(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def scanned(bench: Path, out: Path, **options: Any) -> ScanResult:
    plan, calibration = (
        Plan.load(bench / "session" / "plan.yaml"),
        Calibration.load(bench / "calibration.yaml"),
    )
    with Rig.load(bench / "rig.yaml") as rig:
        return scan(rig, plan, calibration, out, **options)


@pytest.mark.whole
def test_a_scan_in_python_is_that_of_the_command(fpplab: Command, bench: Path, tmp_path: Path) -> None:
    done = fpplab(
        "scan", "--rig", bench / "rig.yaml", "--plan", bench / "session" / "plan.yaml",
        "--calibration", bench / "calibration.yaml", "--out", tmp_path / "command", "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    result = scanned(bench, tmp_path / "python")
    answer = result.summary()
    assert list(answer) == list(done.json)
    assert common(answer) == common(done.json)
    assert answer["report"] == str(tmp_path / "python" / "report.html")
    assert files(tmp_path / "python") == files(tmp_path / "command")
    clouds = [(tmp_path / name / "cloud.ply").read_bytes() for name in ("python", "command")]
    assert clouds[0] == clouds[1]


def test_a_scan_can_go_without_a_report(bench: Path, tmp_path: Path) -> None:
    shares: list[float] = []
    result = scanned(bench, tmp_path / "scan", report=False, progress=shares.append)
    assert result.report_file is None
    assert not (tmp_path / "scan" / "report.html").exists()
    assert shares == sorted(shares)
    assert 0.8 < shares[-1] <= 1.0
    assert result.cloud is not None
    assert result.points is result.cloud.points  # type: ignore[attr-defined]
    assert f"{len(result.cloud)} points" in repr(result)
    assert f"{len(result.cloud):,}" in result._repr_html_()
    assert result.diagnosis.verdict in result._repr_html_()
    with pytest.raises(AttributeError, match="nonsense"):
        _ = result.nonsense  # type: ignore[attr-defined]


@pytest.mark.whole
def test_the_verdict_is_told_before_the_report_is_drawn_if_it_is(
    fpplab: Command, bench: Path, tmp_path: Path
) -> None:
    words = "--calibration", bench / "calibration.yaml", "--out", tmp_path / "cloud.ply", "--json"
    done = fpplab("reconstruct", bench / "session", *words)
    assert done.err.index("verdict: ") < done.err.index("Drawing the report")
    assert done.err.count("verdict: ") == 1
    plain = fpplab("reconstruct", bench / "session", *words, "--force", "--report", "no")
    assert plain.json["report"] is None
    assert "Drawing" not in plain.err


@pytest.mark.whole
def test_a_reconstruction_in_python_is_that_of_the_command(
    fpplab: Command, bench: Path, tmp_path: Path
) -> None:
    words = "--calibration", bench / "calibration.yaml", "--out", tmp_path / "command.ply", "--json"
    done = fpplab("reconstruct", bench / "session", *words)
    assert done.code == 0, done.err
    session, calibration = Session.open(bench / "session"), Calibration.load(bench / "calibration.yaml")
    result = reconstruct(session, calibration, out=tmp_path / "python.ply")
    assert list(result.summary()) == list(done.json)
    assert common(result.summary()) == common(done.json)
    assert (tmp_path / "python.html").is_file()
    assert (tmp_path / "python.ply").read_bytes() == (tmp_path / "command.ply").read_bytes()


def test_a_reconstruction_unpacks_and_writes_nothing(bench: Path) -> None:
    before = files(bench)
    calibration = Calibration.load(bench / "calibration.yaml")
    decoded, cloud = reconstruct(Session.open(bench / "session"), calibration)
    assert len(cloud) == decoded.valid.sum()
    assert files(bench) == before


def test_a_session_without_points_is_useless_in_python_too(tmp_path: Path) -> None:
    recorded(faulty("projector_focus", 101), tmp_path)
    calibration = Calibration.load(tmp_path / "calibration.yaml")
    with pytest.raises(UselessScanError) as refused:
        reconstruct(Session.open(tmp_path / "session"), calibration)
    assert refused.value.diagnosis.findings[0].cause.key == "projector_focus"


@pytest.mark.whole
def test_a_cloud_is_there_before_its_report_and_not_left_without(
    bench: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, result: ScanResult) -> None:
        assert path.with_suffix(".ply").is_file()
        raise DataError(f"{path}: no space left on the disk")

    monkeypatch.setattr("fpplab.report.scans.write_scan_report", full)
    with pytest.raises(DataError, match="no space left"):
        reconstruct(bench / "session", bench / "calibration.yaml", out=tmp_path / "cloud.ply")
    assert files(tmp_path) == set()
