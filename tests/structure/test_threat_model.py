"""Each line of the page on what is trusted names a test, and there is that test."""

import re

from tests.support.commands import ROOT

PAGE = ROOT / "docs" / "explanation" / "threat-model.md"
NAMED = re.compile(r"`(tests/[\w/]+\.py)::(\w+)`")


def test_each_line_names_a_test_that_exists() -> None:
    text = PAGE.read_text(encoding="utf-8")
    rows = [line for line in text.splitlines() if line.startswith("| ") and not line.endswith("Test |")]
    assert len(rows) > 20
    assert [row for row in rows if not NAMED.search(row)] == []
    gone = []
    for file, test in NAMED.findall(text):
        path = ROOT / file
        if not path.is_file() or f"def {test}(" not in path.read_text(encoding="utf-8"):
            gone.append(f"{file}::{test}")
    assert gone == []
