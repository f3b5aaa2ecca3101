"""`fpplab check --out FOLDER` keeps a picture of each finding, and the page shows it."""

import html
from pathlib import Path

import pytest

from fpplab.core import config
from tests.support.commands import Command
from tests.support.faulty_rig import formula_rig


@pytest.mark.whole
def test_pictures_are_numbered_as_the_findings_rank(fpplab: Command, tmp_path: Path) -> None:
    rig = tmp_path / "rig.yaml"
    rig.write_text(config.dump(formula_rig("projector_focus", 2).file))
    words = "--rig", rig, "--plan", "plan_nine_images", "--report", tmp_path / "page.html"
    done = fpplab("check", *words, "--out", tmp_path / "kept", "--json")
    assert done.code == 3, done.err
    named = [one["cause"] for one in done.json["findings"]]
    kept = [f"{k + 1:02d}_{cause}.png" for k, cause in enumerate(named)]
    assert sorted(path.name for path in (tmp_path / "kept").iterdir()) == [*kept, "levels.png"]
    assert done.json["pictures"] == [str(tmp_path / "kept" / name) for name in (*kept, "levels.png")]
    page = html.unescape((tmp_path / "page.html").read_text())
    assert "What shows it" in page
    assert done.json["findings"][0]["evidence"] in page
