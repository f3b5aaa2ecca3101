"""`--verbose` and `--log`: what is done and how long it takes, and nothing without."""

import logging
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from fpplab.acquisition.acquire import acquire
from fpplab.cli.logs import LOGGERS, start_logging, stop_logging
from fpplab.core.errors import DataError
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.sessions.session import Session
from tests.support.commands import ROOT, Command
from tests.support.recorded import record

RIG = ROOT / "tests/conformance/rigs/rig_reference.yaml"


@pytest.fixture
def quiet() -> Iterator[None]:
    yield
    stop_logging()


@pytest.fixture
def session(tmp_path: Path) -> Path:
    return record(tmp_path / "s").path


def without_seconds(text: str) -> str:
    """The text with the times taken from it."""
    return re.sub(r" *\d+\.\d+ s\b", "", text)


def test_without_the_options_nothing_more_is_said(fpplab: Command, session: Path, tmp_path: Path) -> None:
    done = fpplab("view", session, "--out", tmp_path / "v.rrd", "--json")
    assert done.code == 0, done.err
    assert done.err == "Reading the session …\n"


@pytest.mark.parametrize("place", ["before", "behind"])
def test_verbose_tells_on_stderr_what_is_done(
    fpplab: Command, session: Path, tmp_path: Path, place: str
) -> None:
    words = ["view", session, "--out", tmp_path / "v.rrd", "--json"]
    done = fpplab(*(["-v", *words] if place == "before" else [*words, "--verbose"]))
    assert done.code == 0, done.err
    assert done.json["session"] == str(session)  # one JSON object, whatever else is said
    said = [line.strip() for line in without_seconds(done.err).splitlines()]
    assert f"session {session} opened: 4 of 4 frames" in said


def test_phases_tell_how_long_they_took(fpplab: Command, tmp_path: Path) -> None:
    done = fpplab("artefact", "steps", "--layer", 1.0, "--out", tmp_path / "a.stl", "--json", "-v")
    assert done.code == 0, done.err
    assert re.search(r"^ +\d+\.\d{3} s  Slicing: \d+\.\d{3} s$", done.err, re.M)


def test_a_log_has_details_and_tracebacks_and_stderr_does_not(
    fpplab: Command, session: Path, tmp_path: Path
) -> None:
    log, out = tmp_path / "log.txt", tmp_path / "x.npz"
    out.write_text("")
    plain = fpplab("decode", session, "--out", out, "--json")
    done = fpplab("decode", session, "--out", out, "--json", "--log", log)
    assert (done.code, done.out, done.err) == (plain.code, plain.out, plain.err)
    assert done.code == 2
    written = log.read_text()
    assert " INFO fpplab.cli.logs: fpplab " in written
    assert " DEBUG " in written
    assert "Traceback (most recent call last)" in written
    assert f"ConfigError: {out}: exists already" in written
    fpplab("decode", session, "--out", out, "--json", "--log", log)
    assert log.read_text().startswith(written)  # appended


def test_a_log_that_cannot_be_written_is_refused(fpplab: Command, session: Path, tmp_path: Path) -> None:
    done = fpplab("decode", session, "--out", tmp_path / "x.npz", "--json", "--log", tmp_path / "no" / "log")
    assert done.code == DataError.exit_code
    assert str(tmp_path / "no" / "log") in done.json["error"]
    assert not (tmp_path / "x.npz").exists()


def test_devices_and_frames_are_logged(
    tmp_path: Path, quiet: None, capsys: pytest.CaptureFixture[str]
) -> None:
    start_logging(True, tmp_path / "log", ["scan"])
    with Rig.load(RIG) as rig:
        plan = Plan(fringes=(Sinusoid(axis="x", stripes=1, steps=4),))
        session = Session.create(tmp_path / "s", plan, rig.described())
        acquire(rig, plan, session)
    written = (tmp_path / "log").read_text()
    for name in ("camera", "projector", "stage", "fixture"):
        assert f"{name} opened: tests.conformance.reference:Reference{name.title()}" in written
    assert "4 frames are to be taken, 0.02 s each" in written
    assert f"4 frames of 48 x 32 at 8 bits read from {session.path}, " in written
    assert "camera opened" in capsys.readouterr().err


def test_warnings_are_shown_as_before(
    tmp_path: Path, quiet: None, capsys: pytest.CaptureFixture[str]
) -> None:
    start_logging(False, tmp_path / "log", [])
    logging.getLogger("sim.light").warning("is discarded")
    logging.getLogger("fpplab").info("detail")
    assert capsys.readouterr().err == "is discarded\n"
    stop_logging()
    assert all(not logging.getLogger(name).handlers for name in LOGGERS)
