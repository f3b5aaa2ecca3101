"""Every report of the page says how it is treated, and names a test that there is."""

import re

import pytest

from tests.docs.test_write_a_driver import ROOT

PAGE = ROOT / "docs" / "field-reports.md"
ROWS = re.findall(
    r"^\| \[([^\]]+)\]\((https://[^)]+)\) \| [^|]+ \| ([^|]+) \| `([^`:]+)::(\w+)` \|$",
    PAGE.read_text(encoding="utf-8"),
    re.MULTILINE,
)


def test_every_row_of_the_page_is_read() -> None:
    lines = [line for line in PAGE.read_text(encoding="utf-8").splitlines() if line.startswith("| [")]
    assert len(lines) == len(ROWS) > 15
    assert len({url for _, url, *_ in ROWS}) == len(ROWS)


@pytest.mark.parametrize(("name", "url", "treatment", "file", "test"), ROWS, ids=[row[0] for row in ROWS])
def test_it_is_treated_and_a_test_holds_it(name: str, url: str, treatment: str, file: str, test: str) -> None:
    assert treatment.split(":")[0].split()[0] in ("prevented", "explained", "documented")
    assert f"def {test}(" in (ROOT / file).read_text(encoding="utf-8")
