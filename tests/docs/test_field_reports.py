"""Every field report says how it is treated, and names a test that there is."""

import pytest

from docs.generate.pages import ROOT
from docs.generate.tables import FIELD_REPORTS, field_reports_page, groups

ROWS = [row for group in groups(FIELD_REPORTS) for row in group["rows"]]


def test_each_report_stands_once_and_on_the_page() -> None:
    assert len({row["link"] for row in ROWS}) == len(ROWS) > 60
    page = field_reports_page()
    assert [row["link"] for row in ROWS if f"]({row['link']}) |" not in page] == []


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row["report"])
def test_it_is_treated_and_a_test_holds_it(row: dict[str, str]) -> None:
    assert set(row) == {"report", "link", "happened", "here", "test"}
    assert row["here"].split(":")[0].split()[0] in ("prevented", "explained", "documented")
    file, _, name = row["test"].partition("::")
    assert f"def {name}(" in (ROOT / file).read_text(encoding="utf-8")
