"""How a result of nested lists and dictionaries is shown to a person."""

import re
from typing import Any

NOT_PRINTED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff]")
"""Characters that a terminal obeys instead of showing them, or that turn the order of others around."""


def printable(text: str) -> str:
    """Write out the characters that a terminal would obey, as Python does in strings."""
    return NOT_PRINTED.sub(lambda match: match[0].encode("unicode_escape").decode(), text)


def readable(value: Any) -> str:
    if isinstance(value, dict) and value:
        return ", ".join(f"{k} {readable(v)}" for k, v in value.items())
    if isinstance(value, list | tuple) and value:
        return ", ".join(readable(v) for v in value)
    if value is None or (isinstance(value, dict | list | tuple) and not value):
        return "none"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def as_table(value: Any) -> tuple[list[str], list[list[Any]]] | None:
    if isinstance(value, dict) and value and all(isinstance(row, dict) for row in value.values()):
        rows = [{"": name, **_flatten_row(row)} for name, row in value.items()]
    elif isinstance(value, list | tuple) and value and all(isinstance(row, dict) for row in value):
        rows = [_flatten_row(row) for row in value]
    else:
        return None
    columns = list(dict.fromkeys(key for row in rows for key in row))
    return columns, [[row.get(column, "") for column in columns] for row in rows]


def _flatten_row(row: dict[str, Any]) -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in row.items():
        inner = {f"{key} {k}": v for k, v in value.items()} if isinstance(value, dict) else {key: value}
        flat |= inner
    return flat
