"""JSON and lines of it from files: read in one place, with faults that are always the same exception."""

import json
from pathlib import Path
from typing import Any


def parse_json(content: bytes | str) -> Any:
    try:
        return json.loads(content)
    except RecursionError:
        raise ValueError("it has too many lists and mappings inside one another") from None


def parse_object(content: bytes | str) -> dict[str, Any]:
    parsed = parse_json(content)
    if not isinstance(parsed, dict):
        raise ValueError("it is not an object with fields")
    return parsed


def json_value(value: Any) -> Any:
    """Give what stands in JSON for a path or a number of NumPy: `json.dumps` asks for it."""
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "item"):
        return value.item()
    raise TypeError(f"{type(value).__name__} does not go into JSON")
