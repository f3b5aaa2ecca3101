"""`python -m benchmarks crash` in short: few moments, of the commands that take seconds."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.crash.bench import bench_is_safe
from benchmarks.crash.content import content_of, timeless
from benchmarks.crash.contests import contest_failures
from benchmarks.crash.kills import kill_failures
from benchmarks.crash.programs import IMPORT, SCAN, SCAN_EMULATED, prepare
from benchmarks.crash.signals import BEFORE, signal_failures
from fpplab.sessions.session import Session
from tests.support.recorded import record


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("crash")
    prepare(place, (SCAN, SCAN_EMULATED, IMPORT))
    return place


@pytest.mark.slow
def test_killed_commands_end_as_undisturbed_ones(folder: Path) -> None:
    found = kill_failures(folder, (SCAN, IMPORT), kills=4, seed=3)
    assert found == {kind: [] for kind in found}


@pytest.mark.slow
def test_interrupted_commands_leave_a_safe_bench(folder: Path) -> None:
    found = signal_failures(folder, (SCAN_EMULATED,), signals=5, seed=3)
    assert {kind: words for kind, words in found.items() if kind != BEFORE and words} == {}


@pytest.mark.slow
def test_one_of_two_commands_wins(folder: Path) -> None:
    found = contest_failures(folder, contests=1)
    assert found == {kind: [] for kind in found}


def test_results_are_compared_without_times_and_names(tmp_path: Path) -> None:
    for name in ("one", "other"):
        record(tmp_path / name / "out")
    first, second = (content_of(tmp_path / name / "out") for name in ("one", "other"))
    assert first == second
    assert len(first) == len(Session.open(tmp_path / "one" / "out").records) + 4
    page = '<p>2026-11-25 14:03, 12.5 s</p><a href="data:application/json,%7B%22seconds%22%3A1%7D">x</a>'
    (tmp_path / "a.html").write_text(page, encoding="utf-8")
    (tmp_path / "b.html").write_text(page.replace("14:03", "15:04").replace("12.5", "9"), encoding="utf-8")
    (tmp_path / "c.html").write_text(page.replace("<p>", "<p>no "), encoding="utf-8")
    a, b, c = (timeless(tmp_path / f"{name}.html", "OUT") for name in "abc")
    assert a == b != c


def test_results_that_differ_are_noticed(tmp_path: Path) -> None:
    for name in ("one", "other"):
        record(tmp_path / name / "out")
    frame = next((tmp_path / "other" / "out" / "frames").iterdir())
    frame.write_bytes(frame.read_bytes()[:-1] + b"\xee")
    first, second = (content_of(tmp_path / name / "out") for name in ("one", "other"))
    assert [name for name in first if first[name] != second[name]] == [f"OUT/frames/{frame.name}"]
    (tmp_path / "note.json").write_text('{"open": true}', encoding="utf-8")
    assert not bench_is_safe(tmp_path / "note.json"), "it was never closed"
    assert bench_is_safe(tmp_path / "none.json"), "it was never opened"
