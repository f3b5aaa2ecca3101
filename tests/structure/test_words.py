"""No word of the list in words.py stands anywhere in sources, tests, documentation or examples."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

import pytest

from tests.structure import words
from tests.structure.words import WORDS, class_name, name

ROOT = Path(__file__).parents[2]
PLACES = ("fpplab", "drivers", "sim", "benchmarks", "tests", "docs", "README.md", "configs")
TEXT = (".py", ".md", ".yaml", ".yml", ".html", ".osl", ".sh", ".css", ".js", ".txt", ".toml")


@cache
def lines() -> tuple[tuple[str, str], ...]:
    """Every line of every text, with its place as file:line."""
    found = []
    for place in PLACES:
        for path in [ROOT / place] if (ROOT / place).is_file() else sorted((ROOT / place).rglob("*")):
            if path.suffix in TEXT and path.is_file() and path != Path(words.__file__):
                text = path.read_text(encoding="utf-8").splitlines()
                found += [(f"{path.relative_to(ROOT)}:{n}", line) for n, line in enumerate(text, 1)]
    return tuple(found)


@pytest.mark.parametrize(("pattern", "better"), WORDS, ids=[pattern for pattern, _ in WORDS])
def test_a_word_is_gone(pattern: str, better: str) -> None:
    found = [
        f"{place}: '{match[0]}': better {better}"
        for place, line in lines()
        for match in re.finditer(pattern, line)
    ]
    assert not found, "\n" + "\n".join(found)


def test_patterns_match_names_and_spare_ordinary_words() -> None:
    part, kind = re.compile(name("[Bb]olt")), re.compile(class_name("Bolt"))
    assert all(part.search(line) for line in ("self.bolts", "Bolt(1)", "_bolt_of(x)", "a bolt, then"))
    assert not any(part.search(line) for line in ("unbolt it", "a bolted joint"))
    assert all(
        kind.search(line) for line in ("class Bolt:", "x: Bolt = 1", "-> Bolt:", "list[Bolt]", "Bolt(1)")
    )
    assert not any(kind.search(line) for line in ("Bolt it to the table.", "a note: Bolt it", "a bolt(1)"))
