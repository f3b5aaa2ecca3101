"""Arguments of public functions, which take an object or the path of its file."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from fpplab.core.errors import ConfigError

T = TypeVar("T")


def object_or_file(given: object, kind: type[T], load: Callable[[Path | str], T], name: str) -> T:
    """Give the object, from its file if a path is given; anything else is refused by the argument's name."""
    if isinstance(given, kind):
        return given
    if isinstance(given, str | Path):
        return load(given)
    raise ConfigError(
        f"{name}: takes a {kind.__name__} or the path of its file, not a {type(given).__name__}"
    )
