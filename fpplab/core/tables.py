"""Tables as CSV: of rows, and of all that a command's `--json` answer holds."""

import csv
import io
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fpplab.core.errors import DataError
from fpplab.core.file_kinds import naming_other_kinds
from fpplab.core.files import open_regular, write_text

Row = dict[str, Any]  # values by column; None is an empty cell

SUMMARY = "summary"  # the table of an answer's single values


def write_csv(path: Path, rows: Iterable[Row]) -> None:
    write_text(path, csv_text(rows))


def csv_text(rows: Iterable[Row]) -> str:
    rows = list(rows)
    columns = dict.fromkeys(name for row in rows for name in row)
    stream = io.StringIO(newline="")
    writer = csv.DictWriter(stream, list(columns), restval="")
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


def read_tables(path: Path) -> dict[str, list[Row]]:
    """Read the tables of a `--json` answer, or of a journal with one JSON object in each line."""
    with naming_other_kinds(path, "tables"):
        return _read_tables(path)


def _read_tables(path: Path) -> dict[str, list[Row]]:
    try:
        with open_regular(path) as stream:
            text = stream.read().decode("utf-8")
        if path.suffix.lower() == ".jsonl":
            tables = tables_of({path.stem: [json.loads(line) for line in text.splitlines() if line.strip()]})
        else:
            answer = json.loads(text)
            tables = tables_of(answer if isinstance(answer, Mapping) else {path.stem: answer})
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from error
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: is no JSON of fpplab ({error})") from error
    if not tables:
        raise DataError(f"{path}: holds no table")
    return tables


def tables_of(answer: Mapping[str, Any]) -> dict[str, list[Row]]:
    # A list of objects is a table, named by the keys that lead to it; a list in its rows is another one,
    # whose rows say in the first column to which row they belong, counted from 0. What is said once is a row
    # of the table `SUMMARY`. Keys of objects within objects are joined by dots, as are the places in lists of
    # numbers.
    tables: dict[str, list[Row]] = {SUMMARY: []}
    row: Row = {}
    _arrange(answer, "", "", row, tables)
    if row:
        tables[SUMMARY].append(row)
    return {name: rows for name, rows in tables.items() if rows}


def _arrange(value: Any, key: str, table: str, row: Row, tables: dict[str, list[Row]]) -> None:
    """Put a value into the row under its key, and objects in lists into tables of their own."""
    if isinstance(value, Mapping):
        for name, part in value.items():
            _arrange(part, f"{key}.{name}" if key else str(name), table, row, tables)
    elif isinstance(value, list) and any(isinstance(part, Mapping) for part in value):
        name = f"{table}.{key}" if table else key
        rows = tables.setdefault(name, [])
        above = {table: len(tables[table])} if table else {}
        for part in value:
            made: Row = dict(above)
            _arrange(part, "" if isinstance(part, Mapping) else "value", name, made, tables)
            rows.append(made)
    elif isinstance(value, list):
        for i, part in enumerate(value):
            _arrange(part, f"{key}.{i}", table, row, tables)
    else:
        row[key] = value
