"""The page of faults is that of its table, and every test that the table names exists."""

import ast

import pytest

from tests.docs.faults import COLUMNS, PAGE, ROOT, groups, page

ROWS = [row for group in groups() for row in group["faults"]]


def test_the_page_is_up_to_date() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "run `python -m tests.docs.faults`"


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["fault"][:40])
def test_a_row_is_whole_and_its_test_exists(row: dict[str, str]) -> None:
    assert set(row) == set(COLUMNS)
    assert all(row.values())
    file, _, name = row["proved_by"].partition("::")
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    assert name in [node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def test_no_fault_stands_twice() -> None:
    faults = [row["fault"] for row in ROWS]
    assert len(set(faults)) == len(faults)
