"""`decode` says whether to believe its maps, by the words and exit codes of a scan."""

from pathlib import Path

import pytest

from fpplab.devices import CameraSettings, Frame
from fpplab.diagnosis import UselessScanError
from fpplab.patterns.recording import Recording
from fpplab.results.maps import DecodingResult
from fpplab.sessions.session import Session
from fpplab.workflows.maps import DecodingRequest, run_decoding
from tests.phase.test_bent_phases import SIZE, bent
from tests.support.commands import Command


def recorded(recording: Recording, folder: Path) -> Path:
    """Leave frames as a session."""
    rig = {"resolved": {"projector": {"size": list(recording.projector_size), "lattice": "square"}}}
    session = Session.create(folder / "session", recording.plan, rig)
    for index, ((_, _, name), image) in enumerate(zip(recording.plan.steps(), recording.frames, strict=True)):
        session.write(Frame(image, index, CameraSettings(0.02, 0.0, 8), 0.0, pattern_id=name))
    return session.path


def decoded(recording: Recording, folder: Path, *, as_recorded: bool = False) -> DecodingResult:
    return run_decoding(DecodingRequest(recorded(recording, folder), folder / "maps.npz", as_recorded))


def with_orders_in_doubt(seed: int) -> Recording:
    """A plan that asks for surer orders than the noise of its wide stripe allows."""
    recording = bent([(1, 3), (100, 3)], 1.0, seed)[0]
    masks = recording.plan.masks.model_copy(update={"wrong_order_max": 1e-9})
    plan = recording.plan.model_copy(update={"masks": masks})
    return Recording(recording.frames, plan, recording.projector_size)


def test_maps_without_fault_are_good(tmp_path: Path) -> None:
    result = decoded(bent([(1, 4), (8, 4), (64, 4)], 1.0, seed=5)[0], tmp_path)
    summary = result.summary()
    assert (summary["verdict"], summary["findings"]) == ("good", [])
    assert summary["valid"] == SIZE[0] * SIZE[1]
    assert summary["unverified"][0].startswith("geometry")
    assert {one["name"] for one in summary["criteria"]} >= {"points", "contrast", "waves", "wrong_order_risk"}
    assert (tmp_path / "maps.npz").is_file()


@pytest.mark.whole
def test_useless_maps_are_not_written(tmp_path: Path, fpplab: Command) -> None:
    session = recorded(with_orders_in_doubt(6), tmp_path)
    done = fpplab("decode", session, "--out", tmp_path / "maps.npz", "--json")
    assert (done.code, done.json["verdict"]) == (4, "useless"), done.err
    assert "of an uncertain fringe order" in done.json["reason"]
    assert not (tmp_path / "maps.npz").exists()


def test_of_a_bent_response_the_exponent_is_told(tmp_path: Path) -> None:
    result = decoded(bent([(1, 3), (16, 3)], 2.2, seed=8)[0], tmp_path)
    assert result.diagnosis.is_useless
    assert result.diagnosis.findings[0].cause.key == "response"
    with pytest.raises(UselessScanError, match=r"exponent \(gamma\) 2\.[12]\d; measure the response"):
        result.require_usable()


def test_maps_that_were_asked_for_as_recorded_are_left_with_their_verdict(tmp_path: Path) -> None:
    recording = bent([(1, 4), (8, 4), (64, 4)], 1.0, seed=9)[0]
    finest = recording.plan.fringes[2].model_copy(update={"stripes": 64.3})
    wrong = recording.plan.model_copy(update={"fringes": (*recording.plan.fringes[:2], finest)})
    frames = Recording(recording.frames, wrong, recording.projector_size)
    result = decoded(frames, tmp_path, as_recorded=True)
    assert result.diagnosis.is_useless
    assert "wrong_plan" in [one.cause.key for one in result.diagnosis.findings]
    assert (tmp_path / "maps.npz").is_file()
    result.require_usable()
