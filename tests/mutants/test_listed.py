"""Listed faults are found once in the canonical form of a source, and noticed by the tests that they name."""

import ast
import re

import pytest

from tests.mutants.choice import Chooser
from tests.mutants.coverage_map import CoverageMap
from tests.mutants.judge import Bench, Verdict
from tests.mutants.listed import ListedFault, canonical, definitions, listed
from tests.mutants.tree import ROOT, copy_tree

SOURCE = '''\
"""A module; limit = 3 is in its docstring."""

SIZES = {"width": 4, "height": 3}  # 4 µm, and limit = 3


class Lens:
    """With a docstring."""

    @property
    def focus(self) -> float:
        return self.length  # µm

    @focus.setter
    def focus(self, value: float) -> None:
        if value < 0:
            raise ValueError(f"focus {value} µm", "at least 0")
        elif value > 9:
            value = 9
        self.length = value

    @staticmethod
    def make(kind: object, limit: int = 2) -> "Lens":
        try:
            lens = open_lens(
                kind, limit=limit,  # of the opening
                exclusive=True)
        except (OSError, ValueError) as error:
            raise TypeError("no lens") from error
        return (lens * 2)
'''


def seeded(within: str, old: str, new: str) -> list[str]:
    """Lines that a fault changes, as they are then."""
    fault = ListedFault("a fault", "m.py", 1, within, old, new, "tests/test_m.py::test_m")
    after = fault.seeded(SOURCE.encode()).decode()
    ast.parse(after)
    before = canonical(SOURCE.encode()).splitlines()
    return [line.strip() for line in after.splitlines() if line not in before]


@pytest.mark.parametrize(
    ("within", "old", "new", "changed"),
    [
        ("SIZES", "4", "5", ["SIZES = {'width': 5, 'height': 3}"]),
        ("Lens.focus", "value > 9", "value > 8", ["elif value > 8:"]),
        ("Lens.focus", "raise ValueError(...)", "return", ["return"]),
        ("Lens.focus", "self.length = value", "", ["pass"]),
        (
            "Lens.focus",
            "self.length = value",
            "if value:\n    self.length = 2",
            ["if value:", "self.length = 2"],
        ),
        (
            "Lens.make",
            "exclusive=True",
            "exclusive=False",
            ["lens = open_lens(kind, limit=limit, exclusive=False)"],
        ),
        ("Lens.make", "limit: int=2", "limit: int=3", ["def make(kind: object, limit: int=3) -> 'Lens':"]),
        ("Lens.make", "staticmethod", "classmethod", ["@classmethod"]),
        ("Lens.make", "lens * 2", "lens", ["return lens"]),
    ],
)
def test_only_what_is_replaced_changes(within: str, old: str, new: str, changed: list[str]) -> None:
    assert seeded(within, old, new) == changed


@pytest.mark.parametrize(
    ("within", "old", "times"),
    [
        ("Lens.focus", "self.width", 0),
        ("Lens.focus", "self.length", 2),
        ("Lens.focus", "self.leng", 0),
        ("Lens.missing", "value", 0),
        ("SIZES", "limit = 3", 0),
        ("Lens.focus", "return self.length\nvalue = 9", 0),
    ],
    ids=["not there", "twice", "part of a name", "no such function", "in a comment", "not consecutive"],
)
def test_a_fragment_that_is_not_found_once_is_refused(within: str, old: str, times: int) -> None:
    with pytest.raises(LookupError, match=rf"a fault.*m\.py has {times} places.*{re.escape(within)}"):
        seeded(within, old, "0")


def test_a_property_has_two_definitions_and_a_module_is_its_own() -> None:
    tree = ast.parse(SOURCE)
    assert [node.lineno for node in definitions(tree, "Lens.focus")] == [10, 14]  # type: ignore[attr-defined]
    assert list(definitions(tree, "")) == [tree]


def test_the_named_tests_exist() -> None:
    gone = set()
    for fault in listed(ROOT):
        file, _, function = fault.killed_by.partition("::")
        path = ROOT / file
        name = function.partition("[")[0]
        if not path.exists() or f"def {name}(" not in path.read_text(encoding="utf-8"):
            gone.add(fault.killed_by)
    assert gone == set()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    killers = {fault.name: [fault.killed_by] for fault in listed(ROOT)}
    tree = copy_tree(tmp_path_factory.mktemp("listed") / "tree")
    return Bench(tree, Chooser(ROOT, CoverageMap({}, {}), first=killers))


EVERY = 40  # of the list: `make faults` tries all


@pytest.mark.whole
@pytest.mark.parametrize("place", range(0, 320, EVERY))
def test_a_fault_is_killed(place: int, bench: Bench) -> None:
    trial = bench.try_fault(listed(ROOT)[place])
    assert trial.verdict is Verdict.KILLED, f"{trial.name}: {trial.evidence}"
