"""`--trace` ends in a table of where the time went."""

import time
from pathlib import Path

import pytest

from fpplab.cli.trace import Trace, Usage, limit_of
from tests.support.commands import Command


@pytest.mark.parametrize(
    ("name", "used", "short", "limit"),
    [
        ("Reconstructing", Usage(2.0, 1.9, 0, 0), False, "computing"),
        ("Scanning", Usage(2.0, 0.3, 0, 0), False, "camera"),
        ("Reading", Usage(2.0, 0.3, 200_000_000, 0), False, "disk"),
        ("Reading", Usage(2.0, 0.3, 2_000, 0), False, "other processes"),
        ("Reconstructing", Usage(2.0, 1.9, 0, 0), True, "memory"),
    ],
)
def test_a_phase_says_what_limits_it(name: str, used: Usage, short: bool, limit: str) -> None:
    assert limit_of(name, used, short) == limit


def test_phases_are_measured_where_they_are_asked_for() -> None:
    trace = Trace()
    with trace.phase("before"):
        pass
    trace.enabled = True
    with trace.phase("Waiting"):
        time.sleep(0.02)
    (name, seconds, cpu_s, *_), (whole, whole_s, *_) = trace.rows()
    assert (name, whole) == ("Waiting", "all phases")
    assert 0.02 <= float(str(seconds)) <= float(str(whole_s))
    assert float(str(cpu_s)) < float(str(seconds))


@pytest.mark.whole
def test_a_traced_command_ends_in_its_phases(fpplab: Command, tmp_path: Path) -> None:
    done = fpplab("artefact", "pillars", "--out", tmp_path / "pillars.stl", "--trace", "--json")
    assert done.json
    assert "Where the time went" in done.err
    assert "all phases" in done.err
