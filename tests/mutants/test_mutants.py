"""Faults are seeded where they should be, judged by the tests that execute them, and mended again."""

import ast
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
import yaml

from tests.mutants.__main__ import EQUIVALENT, _confirmed, explained
from tests.mutants.areas import AREAS, draw, files_of
from tests.mutants.choice import Chooser, importers
from tests.mutants.coverage_map import CoverageMap, collected, without_gone
from tests.mutants.judge import Bench, Trial, Verdict
from tests.mutants.listed import listed
from tests.mutants.record import TrialRecord
from tests.mutants.record import test_of as killer_of
from tests.mutants.seeding import mutants
from tests.mutants.tree import ROOT, copy_tree

SOURCE = '''
LIMIT = 3

def f(a: int = 1, b: "list[int] | None" = None) -> bool:
    """Words 1 < 2."""
    assert a < 9
    _log.info("%d", 1)
    if a < LIMIT and not b:
        raise ValueError(f"{a + 1}")
    return max(a, 2) == 2
'''


def test_where_faults_are_seeded(tmp_path: Path) -> None:
    (tmp_path / "m.py").write_text(SOURCE)
    found = {(m.old, m.new) for m in mutants(tmp_path, "m.py")}
    assert found == {
        ("1", "2"),
        ("a < LIMIT", "((a) <= (LIMIT))"),
        ("a < LIMIT and not b", "((a < LIMIT) or (not b))"),
        ("not b", "((b))"),
        ('raise ValueError(f"{a + 1}")', "pass"),
        ("max", "min"),
        ("2", "3"),
        ("max(a, 2) == 2", "((max(a, 2)) != (2))"),
    }


@pytest.mark.parametrize("area", AREAS)
def test_every_fault_is_python_and_none_is_the_source(area: str) -> None:
    for file in files_of(ROOT, area)[:3]:
        source = (ROOT / file).read_bytes()
        for mutant in mutants(ROOT, file)[::20]:
            assert ast.dump(ast.parse(mutant.seeded(source))) != ast.dump(ast.parse(source)), mutant.name


def test_a_draw_is_the_same_twice_and_has_as_many_of_each_area() -> None:
    drawn = draw(ROOT, 2, 1, ("core", "sessions"))
    assert [m.name for m in drawn] == [m.name for m in draw(ROOT, 2, 1, ("core", "sessions"))]
    assert [m.file.split("/")[1] for m in drawn] == ["core", "sessions"] * 2
    assert [m.name for m in drawn] != [m.name for m in draw(ROOT, 2, 2, ("core", "sessions"))]


def test_what_is_drawn_stays_drawn_while_other_code_changes(tmp_path: Path) -> None:
    folder = tmp_path / "fpplab" / "core"
    folder.mkdir(parents=True)
    lines = [f"    {name} = {name} + 1" for name in "abcdefghij"]
    (folder / "m.py").write_text("\n".join(["def old():", *lines]))
    before = [m.name for m in draw(tmp_path, 6, 1, ("core",))]
    (folder / "m.py").write_text("\n".join(["def new():", *lines, "def old():", *lines]))
    after = [m.name for m in draw(tmp_path, 6, 1, ("core",))]
    kept = [name for name in after if " old: " in name]
    assert 0 < len(kept) < 6
    assert kept == before[: len(kept)]


THERE = {"tests/a.py::test_b"}


def test_what_is_killed_is_not_tried_again(tmp_path: Path) -> None:
    killed, survivor, hung = listed(ROOT)[:3]
    path = tmp_path / "map" / "trials.jsonl"
    record = TrialRecord(path, THERE)
    record.add(killed, Trial(killed.name, Verdict.KILLED, "FAILED tests/a.py::test_b"))
    record.add(survivor, Trial(survivor.name, Verdict.SURVIVED, "3 tests"))
    record.add(hung, Trial(hung.name, Verdict.HUNG, "after 9 s"))
    with path.open("a") as stream:
        stream.write('{"name": "torn')
    later = TrialRecord(path, THERE, seconds=0.0)
    assert not later.has_time
    assert [later.known(mutant) is not None for mutant in (killed, survivor, hung)] == [True, False, True]
    assert later.passing == set()
    later.confirm(killed, Trial(killed.name, Verdict.KILLED, "FAILED tests/a.py::test_b"))
    later.confirm(hung, Trial(hung.name, Verdict.UNDECIDED, "it hangs without the fault too"))
    last = TrialRecord(path, THERE)
    assert last.passing == {"tests/a.py::test_b"}
    assert [last.known(mutant) is not None for mutant in (killed, hung)] == [True, False]
    assert last.known(replace(killed, file="fpplab/core/units.py")) is None, "another source"
    assert TrialRecord(path, {"tests/a.py::test_c"}).known(killed) is None, "its test is gone"


class SoundBench:
    """The unharmed sources, where some tests fail too."""

    def __init__(self, failing: list[str]) -> None:
        self.failing = failing

    def run(self, tests: list[str], limit: float) -> str:
        failed = [f for f in self.failing if any(f == test or f.startswith(f"{test}::") for test in tests)]
        return f"FAILED {failed[0]}" if failed else ""


class CrashingBench(Bench):
    """Tests end by other means than a failure: on the fault alone, or on the unharmed sources too."""

    def __init__(self, tree: Path, chooser: Chooser, endings: list[str]) -> None:
        super().__init__(tree, chooser)
        self.endings = endings

    def run(self, tests: list[str], limit: float) -> str:
        return self.endings.pop(0)


@pytest.mark.parametrize(
    ("endings", "verdict"),
    [
        (["Fatal Python error: Segmentation fault", ""], Verdict.KILLED),
        (["ERROR: not found: tests/a.py::gone", "ERROR: not found: tests/a.py::gone"], Verdict.UNDECIDED),
        (["ERROR tests/a.py"], Verdict.KILLED),
        (["FAILED tests/a.py::test[a b]"], Verdict.KILLED),
        ([""], Verdict.SURVIVED),
    ],
)
def test_an_ending_that_names_no_test_is_compared_with_the_unharmed_sources(
    tmp_path: Path, endings: list[str], verdict: Verdict
) -> None:
    mutant = listed(ROOT)[0]
    (tmp_path / mutant.file).parent.mkdir(parents=True)
    (tmp_path / mutant.file).write_bytes((ROOT / mutant.file).read_bytes())
    chooser = SimpleNamespace(tests_for=lambda _: ["tests/a.py::a"], seconds_of=lambda _: 1.0)
    trial = CrashingBench(tmp_path, cast(Chooser, chooser), endings).try_fault(mutant)
    assert (trial.verdict, endings) == (verdict, [])
    assert killer_of(trial) == (trial.evidence.partition(" ")[2] if " tests/" in trial.evidence[:13] else "")


@pytest.mark.whole
def test_tests_that_are_gone_are_not_chosen() -> None:
    here = "tests/mutants/test_mutants.py::test_modules_that_import_another"
    known = CoverageMap({"a.py": {1: [here, f"{here}_one"]}}, {here: 1.0, f"{here}_one": 1.0})
    left = without_gone(known, collected([here.partition("::")[0]]))
    assert (left.lines, left.seconds) == ({"a.py": {1: [here]}}, {here: 1.0})


class EmptyBench(SoundBench):
    """No test of it can be collected."""

    def run(self, tests: list[str], limit: float) -> str:
        return "no tests ran"


def test_a_kill_by_what_fails_anyway_proves_nothing(tmp_path: Path) -> None:
    by_test, by_file, sound = listed(ROOT)[:3]
    killers = {
        by_test: "FAILED tests/a.py::test_a",
        by_file: "ERROR tests/b.py",
        sound: "FAILED tests/c.py::c",
    }
    judged = [(mutant, Trial(mutant.name, Verdict.KILLED, words)) for mutant, words in killers.items()]
    bench = SoundBench(["tests/a.py::test_a", "tests/b.py::test_of_it"])
    trials = _confirmed(judged, TrialRecord(tmp_path / "trials.jsonl", set()), cast(Bench, bench))
    assert [t.verdict for t in trials] == [Verdict.UNDECIDED, Verdict.UNDECIDED, Verdict.KILLED]


def test_tests_that_do_not_run_are_no_verdict(tmp_path: Path) -> None:
    mutant = listed(ROOT)[0]
    bench = EmptyBench([])
    judged = [(mutant, Trial(mutant.name, Verdict.KILLED, "FAILED tests/a.py::test_a"))]
    with pytest.raises(SystemExit, match="no tests ran"):
        _confirmed(judged, TrialRecord(tmp_path / "trials.jsonl", set()), cast(Bench, bench))


def test_explanations_are_of_faults_that_exist() -> None:
    assert isinstance(yaml.safe_load(EQUIVALENT.read_text(encoding="utf-8")) or {}, dict)
    by_file: dict[str, set[str]] = {}
    for name in explained():
        file = name.partition(" ")[0]
        by_file.setdefault(file, {mutant.name for mutant in mutants(ROOT, file)})
        assert name in by_file[file], f"{name} is no fault of today's sources"


def test_modules_that_import_another() -> None:
    assert "fpplab/core/config.py" in importers(ROOT, "fpplab/core/strict_yaml.py")
    assert "fpplab/clouds/files.py" in importers(ROOT, "fpplab/clouds/ply.py")


def test_a_default_argument_is_judged_by_who_calls_its_function(tmp_path: Path) -> None:
    folder = tmp_path / "fpplab" / "core"
    folder.mkdir(parents=True)
    (folder / "m.py").write_text("def f(a: int = 1) -> int:\n    return a\n\n\nprint(f())\n")
    known = CoverageMap(
        {"fpplab/core/m.py": {1: ["t.py::first"], 2: ["t.py::calls"], 5: ["t.py::other"]}}, {}
    )
    fault = next(m for m in mutants(tmp_path, "fpplab/core/m.py") if m.old == "1")
    assert set(Chooser(tmp_path, known).tests_for(fault)) == {"t.py::first", "t.py::calls"}


def test_tests_of_the_module_come_before_those_of_the_package_and_others() -> None:
    mutant = next(m for m in mutants(ROOT, "sim/light/plane.py"))
    seconds = {
        "tests/cli/test_a.py::a": 1.0,
        "tests/sim/test_b.py::b": 2.0,
        "tests/sim/test_plane.py::c": 3.0,
    }
    known = CoverageMap({mutant.file: {mutant.line: list(seconds)}}, seconds)
    assert Chooser(ROOT, known).tests_for(mutant) == list(reversed(seconds))
    assert Chooser(ROOT, known, seconds=5.0).tests_for(mutant) == list(reversed(seconds))[:2]


@pytest.mark.whole
def test_a_fault_is_killed_a_harmless_one_survives_and_the_copy_is_mended(tmp_path: Path) -> None:
    file, test = "fpplab/core/strict_json.py", "tests/core/test_reading.py::test_json_of_an_object_is_one"
    wanted = next(m for m in mutants(ROOT, file) if "isinstance" in m.old)
    known = CoverageMap({file: {wanted.line: [test]}}, {test: 1.0})
    bench = Bench(copy_tree(tmp_path / "tree"), Chooser(ROOT, known))
    assert bench.try_fault(wanted).verdict is Verdict.KILLED
    assert (tmp_path / "tree" / file).read_bytes() == (ROOT / file).read_bytes()
    other = next(m for m in mutants(ROOT, "fpplab/core/system.py"))
    assert bench.try_fault(other).verdict is Verdict.UNTESTED
