"""Every fault of the table is whole, and the test that it names exists."""

import ast

import pytest

from docs.generate.pages import ROOT
from docs.generate.tables import FAULTS, faults_page, groups

ROWS = [row for group in groups(FAULTS) for row in group["rows"]]


def test_the_page_has_every_fault() -> None:
    assert [row["fault"] for row in ROWS if f"| {row['fault']} |" not in faults_page()] == []


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["fault"][:40])
def test_a_row_is_whole_and_its_test_exists(row: dict[str, str]) -> None:
    assert set(row) == {"fault", "seen", "lost", "proved_by"}
    assert all(row.values())
    file, _, name = row["proved_by"].partition("::")
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    assert name in [node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def test_no_fault_stands_twice() -> None:
    faults = [row["fault"] for row in ROWS]
    assert len(set(faults)) == len(faults)
