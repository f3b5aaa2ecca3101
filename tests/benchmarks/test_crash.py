"""`python -m benchmarks crash` in short: few moments, of the commands that take seconds."""

import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks.crash import crash_figures
from benchmarks.crash.bench import bench_is_safe
from benchmarks.crash.content import content_of, timeless
from benchmarks.crash.programs import IMPORT, SCAN, SCAN_EMULATED, EndedRun
from benchmarks.crash.record import Campaign, CrashCase, CrashRecord
from benchmarks.crash.signals import AFTER, BEFORE, EARLY_TRACE, WRONG_CODE, _complaints, _heard_by_children
from fpplab.sessions.session import Session
from tests.support.recorded import record

FEW = {"kills": (4, (SCAN, IMPORT)), "signals": (5, (SCAN_EMULATED,)), "contests": (1, (SCAN,))}
"""How often, and which programs are disturbed."""


def disturbed(part: str, record: CrashRecord) -> dict[str, float]:
    """What went wrong, by kind."""
    count, programs = FEW[part]
    figures = crash_figures(record, (part,), programs, count, seed=3)
    return {figure.name: figure.value for figure in figures if figure.value > figure.baseline}


@pytest.mark.nightly
def test_killed_commands_end_as_undisturbed_ones(tmp_path: Path) -> None:
    record = CrashRecord(tmp_path / "record.jsonl")
    assert disturbed("kills", record) == {}
    assert sum(case.disturbances for case in record.cases) >= 4


@pytest.mark.nightly
def test_interrupted_commands_leave_a_safe_bench(tmp_path: Path) -> None:
    assert disturbed("signals", CrashRecord(tmp_path / "record.jsonl")) == {}


@pytest.mark.nightly
def test_one_of_two_commands_wins(tmp_path: Path) -> None:
    assert disturbed("contests", CrashRecord(tmp_path / "record.jsonl")) == {}


def test_an_interrupted_benchmark_goes_on(tmp_path: Path) -> None:
    path = tmp_path / "build" / "record.jsonl"
    first = CrashRecord(path)
    first.add(CrashCase("kills", SCAN.name, 0, 3, 1.5, [("lost", "frame 1")]))
    with path.open("a") as stream:
        stream.write('{"part": "ki')  # killed while it wrote
    record = CrashRecord(path)
    assert record.cases[0].disturbances == 3
    campaign = Campaign(tmp_path, (SCAN, IMPORT), 10, 1, record)
    wanted = round(10 * SCAN.share / (SCAN.share + IMPORT.share))
    assert list(campaign.due("kills")) == [(SCAN, wanted - 3), (IMPORT, 10 - wanted)]
    assert not CrashRecord(path, seconds=0.0).has_time
    assert list(Campaign(tmp_path, (SCAN,), 10, 1, CrashRecord(path, 0.0)).due("kills")) == []


def test_a_signal_that_is_swallowed_is_noticed() -> None:
    ended = EndedRun(0, "{}", "", disturbed=True, seconds=3.0, after_s=1.0)
    assert [kind for kind, _ in _complaints(ended, signal.SIGINT, "x")] == [WRONG_CODE]
    assert list(_complaints(replace(ended, after_s=0.01), signal.SIGINT, "x")) == []
    assert list(_complaints(replace(ended, code=130), signal.SIGINT, "x")) == []


def test_programs_hear_what_the_benchmark_ignores_in_the_background() -> None:
    code = "import signal; print(signal.getsignal(signal.SIGHUP) is signal.SIG_DFL)"
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with _heard_by_children():
            done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert done.stdout == "True\n"
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_who_dies_before_the_first_line_may_not_have_left_anything() -> None:
    ended = EndedRun(-signal.SIGTERM, "", "", disturbed=True, seconds=0.01, after_s=0.01)
    for wrote, kinds in ((False, [BEFORE]), (True, [BEFORE, EARLY_TRACE])):
        assert [kind for kind, _ in _complaints(ended, signal.SIGTERM, "x", wrote)] == kinds
    within = replace(ended, err='  File "/x/fpplab/cli/app.py", line 3, in <module>\n')
    assert [kind for kind, _ in _complaints(within, signal.SIGTERM, "x")] == [WRONG_CODE]
    working = replace(ended, err="Scanning …\n")
    assert [kind for kind, _ in _complaints(working, signal.SIGTERM, "x")] == [WRONG_CODE]


def test_who_dies_after_the_answer_has_given_all_of_it() -> None:
    ended = EndedRun(-signal.SIGINT, '{"file": "a"}\n', "", disturbed=True, seconds=3.0, after_s=0.1)
    assert [kind for kind, _ in _complaints(ended, signal.SIGINT, "x", wrote=True)] == [AFTER]
    for answer in ('{"file": ', '{"error": "x"}'):
        torn = replace(ended, out=answer)
        assert [kind for kind, _ in _complaints(torn, signal.SIGINT, "x", wrote=True)] == [WRONG_CODE]


def test_ends_before_the_first_line_are_a_figure_but_no_fault(tmp_path: Path) -> None:
    record = CrashRecord(tmp_path / "record.jsonl")
    for number, kind in enumerate((BEFORE, WRONG_CODE)):
        record.add(CrashCase("signals", SCAN.name, number, 1, 0.1, [(kind, "x")]))
    figures = {one.name: one for one in crash_figures(record, ("signals",), (SCAN,), count=2)}
    assert (figures[BEFORE].value, figures[BEFORE].baseline) == (1, 2)
    assert (figures[WRONG_CODE].value, figures[WRONG_CODE].baseline) == (1, 0)


def test_results_are_compared_without_times_and_names(tmp_path: Path) -> None:
    for name in ("one", "other"):
        record(tmp_path / name / "out")
    first, second = (content_of(tmp_path / name / "out") for name in ("one", "other"))
    assert first == second
    assert len(first) == len(Session.open(tmp_path / "one" / "out").records) + 4
    page = '<p>2026-11-25 14:03, 12.5 s</p><a href="data:application/json,%7B%22seconds%22%3A1%7D">x</a>'
    (tmp_path / "a.html").write_text(page, encoding="utf-8")
    later = page.replace("14:03", "15:04").replace("12.5", "1 min 9")
    (tmp_path / "b.html").write_text(later, encoding="utf-8")
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
