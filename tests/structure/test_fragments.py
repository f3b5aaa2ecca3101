"""Fragments are found by structure and replaced where they stand; every seeded fault finds its place.

Outside of tests/conformance, which judges copies with a fault in them: there the fault has no place any more.
"""

from __future__ import annotations

import ast
from functools import cache

import pytest

from tests.conformance.fault import Fault
from tests.conformance.fault_list import FAULTS
from tests.conformance.fragments import replace
from tests.conformance.seeded_faults import ROOT, seeded

SOURCE = '''\
"""A module; limit = 3 is in its docstring."""

SIZES = {"width": 4, "height": 3}  # 4 µm, and limit = 3


class Lens:
    """With a docstring."""

    @property
    def focus(self) -> float:
        """It says: return self.length."""
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
            found = open_lens(kind, limit=limit, exclusive=True)
        except (OSError, ValueError) as error:
            raise TypeError("no lens") from error
        match kind:
            case str(name) if name:  # é
                return found
            case int():
                pass
        return found * 2
'''


def lines(source: str) -> list[str]:
    return [line.strip() for line in source.splitlines()]


@cache
def text(file: str) -> str:
    return (ROOT / file).read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("within", "old", "new", "changed"),
    [
        ("SIZES", "4", "5", 'SIZES = {"width": 5, "height": 3}  # 4 µm, and limit = 3'),
        ("Lens.focus", "value > 9", "value > 9 or not value", "elif (value > 9 or not value):"),
        ("Lens.focus", "if value < 0:", "if value < 1:", "if value < 1:"),
        ("Lens.focus", "if value > 9:", "if value > 8:", "elif value > 8:"),
        ("Lens.focus", "raise ValueError(...)", "return", "return"),
        ("Lens.focus", "self.length = value", "", "pass"),
        (
            "Lens.make",
            "exclusive=True",
            "exclusive=False",
            "found = open_lens(kind, limit=limit, exclusive=False)",
        ),
        (
            "Lens.make",
            "except (OSError,ValueError) as error:",
            "except KeyError as error:",
            "except KeyError as error:",
        ),
        ("Lens.make", "case str(name) if name:", "case str(name):", "case str(name):  # é"),
        ("Lens.make", "case int():", "case float():", "case float():"),
        ("Lens.make", "raise TypeError(...) from ...", "raise", "raise"),
        ("Lens.make", "found*2", "found", "return found"),
    ],
)
def test_only_what_is_replaced_changes(within: str, old: str, new: str, changed: str) -> None:
    result = replace(SOURCE, within, old, new)
    ast.parse(result)
    assert [line for line, was in zip(lines(result), lines(SOURCE), strict=True) if line != was] == [changed]


def test_formatting_and_comments_make_no_difference() -> None:
    source = (
        "def f(x):\n    # one\n    y = (  # two\n        x[ 0 ]\n    )  # three\n    return g(\n        y)\n"
    )
    result = replace(source, "f", "y=x[0]\nreturn g(y)", "x += 1\nreturn x")
    assert result == "def f(x):\n    # one\n    x += 1\n    return x\n"


def test_a_body_of_an_ellipsis_stands_for_any() -> None:
    result = replace(
        SOURCE, "Lens.make", "try:\n    ...\nexcept (OSError, ValueError) as error:\n    ...", "found = None"
    )
    assert "        found = None\n        match kind:\n" in result


@pytest.mark.parametrize(
    ("within", "old", "new"),
    [
        ("Lens.focus", "self.width", "0"),
        ("Lens.focus", "self.length", "0"),
        ("Lens.missing", "value", "0"),
        ("SIZES", "limit = 3", ""),
        ("Lens.focus", "return self.length\nvalue = 9", ""),
        ("Lens.make", "if name:", "if True:"),
        ("Lens.make", "exclusive = False", "exclusive = True"),
    ],
    ids=[
        "not there",
        "twice",
        "no such function",
        "in a comment",
        "not consecutive",
        "a guard",
        "another value",
    ],
)
def test_a_fragment_that_is_not_found_once_is_refused(within: str, old: str, new: str) -> None:
    with pytest.raises(LookupError):
        replace(SOURCE, within, old, new)


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_every_fault_finds_its_place(fault: Fault) -> None:
    source = text(fault.file)
    assert ast.dump(ast.parse(seeded(fault, source))) != ast.dump(ast.parse(source))


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_every_fault_finds_its_place_in_reformatted_sources(fault: Fault) -> None:
    tree = ast.parse(seeded(fault, text(fault.file)))
    reformatted = ast.parse(seeded(fault, ast.unparse(ast.parse(text(fault.file)))))
    assert ast.unparse(reformatted) == ast.unparse(tree)


def test_a_fault_that_is_not_found_is_named() -> None:
    fault = Fault("a stale fault", "fpplab/devices/device.py", "Device.open", "self.gone()", "")
    with pytest.raises(LookupError, match=r"a stale fault.*device\.py.*0 times.*Device\.open.*self\.gone"):
        seeded(fault, text(fault.file))


def test_names_of_faults_are_unique() -> None:
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)
