"""Answers of commands as tables."""

import csv
import io
from pathlib import Path

import pytest

from fpplab.core.errors import DataError
from fpplab.core.tables import csv_text, read_tables, tables_of


def test_what_is_said_once_is_one_row() -> None:
    answer = {"a": 1, "b": {"c": 2.5, "d": {"e": None}}, "f": [3, [4, 5]], "g": []}
    assert tables_of(answer) == {
        "summary": [{"a": 1, "b.c": 2.5, "b.d.e": None, "f.0": 3, "f.1.0": 4, "f.1.1": 5}]
    }


def test_lists_of_objects_are_tables_that_know_their_rows() -> None:
    answer = {
        "scans": [
            {"name": "x", "at": {"z": 1}, "lengths": [{"um": 1}, {"um": 2}]},
            {"name": "y", "lengths": [{"um": 3, "parts": [{"p": 0}]}]},
        ],
        "mixed": [{"a": 1}, 2],
    }
    assert tables_of(answer) == {
        "scans": [{"name": "x", "at.z": 1}, {"name": "y"}],
        "scans.lengths": [{"scans": 0, "um": 1}, {"scans": 0, "um": 2}, {"scans": 1, "um": 3}],
        "scans.lengths.parts": [{"scans.lengths": 2, "p": 0}],
        "mixed": [{"a": 1}, {"value": 2}],
    }


def test_csv_keeps_commas_quotes_lines_and_digits() -> None:
    rows = [{"a": 'x, "y"\nz', "b": 0.1 + 0.2}, {"b": None, "c": True}]
    text = csv_text(rows)
    assert text.startswith("a,b,c\r\n")
    assert [*csv.reader(io.StringIO(text, newline=""))] == [
        ["a", "b", "c"],
        ['x, "y"\nz', "0.30000000000000004", ""],
        ["", "", "True"],
    ]


def test_a_journal_is_a_table_of_its_name(tmp_path: Path) -> None:
    path = tmp_path / "match.jsonl"
    path.write_text('{"epoch": 0, "loss": 2.0}\n\n{"epoch": 1, "loss": 1.0}\n', encoding="utf-8")
    assert read_tables(path) == {"match": [{"epoch": 0, "loss": 2.0}, {"epoch": 1, "loss": 1.0}]}


@pytest.mark.parametrize("content", [b"{", b"\xff", b"[" * 100_000, b"1e", b"nan()"])
def test_what_is_no_json(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "answer.json"
    path.write_bytes(content)
    with pytest.raises(DataError, match=r"answer\.json: is no JSON of fpplab"):
        read_tables(path)


def test_a_missing_file(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="cannot be read"):
        read_tables(tmp_path / "answer.json")
