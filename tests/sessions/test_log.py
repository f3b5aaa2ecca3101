"""The log of a session: versions, host, phases and their times, warnings, device traffic on request."""

import json
import logging
import os
from pathlib import Path
from typing import Any

import pytest

from fpplab.core.errors import DataError
from fpplab.core.logs import log_traffic, trace_devices
from fpplab.sessions.lock import exclusive_write
from fpplab.sessions.log import begin_session_log
from tests.support.recorded import record

LOGGER = logging.getLogger("fpplab.tests")


@pytest.fixture
def session(tmp_path: Path) -> Path:
    return record(tmp_path / "part").path


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (path / "log.jsonl").read_text(encoding="utf-8").splitlines()]


def test_it_lasts_as_long_as_the_lock(session: Path) -> None:
    levels = {name: logging.getLogger(name).level for name in ("fpplab", "drivers", "sim")}
    with exclusive_write(session):
        LOGGER.info("before")
        begin_session_log(session)
        begin_session_log(session)
        with exclusive_write(session):
            LOGGER.info("decoded", extra={"phase": "decoding", "seconds": 0.25})
        LOGGER.debug("detail")
    LOGGER.info("after")
    begin, phase, end = lines(session)
    assert begin["event"] == "begin"
    assert begin["fpplab"]
    assert begin["packages"]["numpy"]
    assert begin["pid"] == os.getpid()
    assert (phase["message"], phase["phase"], phase["seconds"]) == ("decoded", "decoding", 0.25)
    assert end == {"time": end["time"], "event": "end"}
    assert {name: logging.getLogger(name).level for name in levels} == levels
    assert not logging.getLogger("fpplab").handlers


def _fail(session: Path) -> None:
    begin_session_log(session)
    raise DataError("frame 3 is missing")


def test_it_says_how_the_work_ended_and_a_torn_line_is_cut_off(session: Path) -> None:
    (session / "log.jsonl").write_bytes(b'{"time": "then"}\n{"ti')
    with pytest.raises(DataError), exclusive_write(session):
        _fail(session)
    assert lines(session)[0] == {"time": "then"}
    assert lines(session)[-1]["error"] == "DataError: frame 3 is missing"


def test_device_traffic_is_logged_on_request(session: Path) -> None:
    with exclusive_write(session):
        begin_session_log(session)
        log_traffic("stage", "to", "$H")
        trace_devices(True)
        log_traffic("projector", "to", b"\x00\x01\x1a\x00\x00")
        log_traffic("stage", "from", "ok")
        trace_devices(False)
    said = [(one["device"], one["sent"], one["message"]) for one in lines(session) if "device" in one]
    assert said == [
        ("projector", True, "to projector: 00011a"),
        ("stage", False, "from stage: ok"),
    ]


def test_a_log_that_cannot_be_written_stops_nothing(session: Path) -> None:
    (session / "log.jsonl").mkdir()
    with exclusive_write(session):
        begin_session_log(session)
        LOGGER.info("lost")
    (session / "log.jsonl").rmdir()


def test_warnings_reach_stderr_as_without_it(session: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = logging.getLogger()
    handlers, root.handlers = root.handlers, []  # pytest's own
    try:
        with exclusive_write(session):
            begin_session_log(session)
            LOGGER.warning("mind the step")
            LOGGER.info("quiet")
    finally:
        root.handlers = handlers
    assert capsys.readouterr().err == "mind the step\n"
    assert lines(session)[1]["level"] == "warning"
