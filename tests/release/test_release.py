"""The checks of a release complain of what is wrong, and of nothing else."""

import json
import shutil
import subprocess
from datetime import date
from pathlib import Path

import pytest

from fpplab.core.version import __version__
from tests.release import checks, licences
from tests.release.__main__ import main
from tests.release.checks import Check
from tests.support.commands import ROOT


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    for name in ("pyproject.toml", "CITATION.cff", "CHANGELOG.md"):
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def test_the_page_of_licences_is_that_of_the_dependencies() -> None:
    assert licences.complaints() == []


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("| | pillow | MIT | |\n", "", "pillow: is not on the page"),
        ("| | rich | MIT | |\n", "| | rich | MIT | |\n| | poor | MIT | |\n", "poor: is on the page, and no"),
        ("| | rich | MIT | |\n", "| | rich | BSD | |\n", "rich: the page says BSD, the package"),
        ("| twin | bpy | GPL |", "| | bpy | GPL |", "bpy: GPL may not be among what is always installed"),
    ],
)  # fmt: skip
def test_a_wrong_page(old: str, new: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "licences.md"
    shutil.copy(licences.PAGE, page)
    edit(page, old, new)
    monkeypatch.setattr(licences, "PAGE", page)
    assert any(line.startswith(said) for line in licences.complaints())


def test_the_files_name_one_version(copy: Path) -> None:
    assert checks.versions(copy) == ""
    edit(copy / "CITATION.cff", f"version: {__version__}", "version: 9.9.9")
    assert "CITATION.cff says 9.9.9" in checks.versions(copy)


def test_the_files_name_one_day(copy: Path) -> None:
    edit(copy / "CITATION.cff", 'date-released: "20', 'date-released: "19')
    assert checks.versions(copy).startswith("the days differ: ")


def test_the_change_log_is_closed_on_the_day(tmp_path: Path) -> None:
    log = tmp_path / "CHANGELOG.md"
    log.write_text("## [Unreleased]\n\n## [1.0.0] - 2026-03-01\n\n- A.\n", encoding="utf-8")
    assert checks.unreleased(tmp_path, date(2026, 3, 1)) == ""
    assert "dates the release 2026-03-01" in checks.unreleased(tmp_path, date(2026, 3, 2))
    log.write_text("## [Unreleased]\n\n- B.\n\n## [1.0.0] - 2026-03-01\n", encoding="utf-8")
    assert "under Unreleased" in checks.unreleased(tmp_path, date(2026, 3, 1))


def test_what_is_not_committed(tmp_path: Path) -> None:
    assert "release from a checkout" in checks.uncommitted(tmp_path)
    subprocess.run(["git", "init", "-q", tmp_path], check=True)
    assert checks.uncommitted(tmp_path) == ""
    (tmp_path / "new.txt").write_text("x", encoding="utf-8")
    assert checks.uncommitted(tmp_path) == "not committed: new.txt"


def test_a_command_that_fails_says_why() -> None:
    assert checks.python("-c", "pass")() == ""
    assert "ended with 3: why" in checks.python("-c", "print('why'); raise SystemExit(3)")()


def test_the_walk(capsys: pytest.CaptureFixture[str]) -> None:
    three = (
        Check("a", "A holds", lambda: ""),
        Check("b", "B holds", lambda: "not so"),
        Check("c", "C is done"),
    )
    assert main([], three) == 1
    assert capsys.readouterr().out.splitlines() == [
        "a          A holds: ok",
        "b          B holds: FAILED: not so",
        "c          C is done: OPEN; do it, and add --confirmed c",
    ]
    assert main(["a", "c", "--confirmed", "c"], three) == 0
    with pytest.raises(SystemExit, match="2"):
        main(["d"], three)
    assert "there is no check 'd'; there are a, b, c" in capsys.readouterr().err


def test_every_check_has_a_name_of_its_own() -> None:
    assert len({check.name for check in checks.CHECKS}) == len(checks.CHECKS)


@pytest.mark.nightly
def test_the_bill_of_materials_names_blender_s_licence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checks, "DIST", tmp_path)
    assert checks.bill_of_materials() == ""
    (made,) = tmp_path.iterdir()
    bill = json.loads(made.read_text(encoding="utf-8"))
    listed = {
        component["name"].lower().replace("_", "-"): json.dumps(component.get("licenses"))
        for component in bill["components"]
    }
    assert "GPL-3.0" in listed["bpy"]
    assert {package for _, package in licences.required()} - {*listed} == set()
