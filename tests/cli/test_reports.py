"""The pages that commands write: `compare --report`, `report`, and the demonstration's."""

import base64
import json
import re
from pathlib import Path
from typing import Any

from tests.support.commands import Command, Demo


def held(page: Path) -> dict[str, Any]:
    """The data that a page holds."""
    link = re.search(
        r'id="data" href="data:application/json;base64,([^"]*)"', page.read_text(encoding="utf-8")
    )
    assert link is not None
    data = json.loads(base64.b64decode(link[1]))
    assert isinstance(data, dict)
    return data


def test_scans_side_by_side(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    page = tmp_path / "scans.html"
    done = fpplab(
        "report", demo.folder / "pyramid", demo.folder / "steps" / "cloud.ply", "--out", page, "--json"
    )
    assert done.code == 0, done.err
    assert [one["name"] for one in done.json["scans"]] == ["pyramid", "steps"]
    assert [one["verdict"] for one in done.json["scans"]] == ["unverified", "unverified"]
    assert done.json["differences"][0]["pixels"] > 10_000
    whence = done.json["provenance"]["pyramid"]
    assert whence["calibration"] == "calibration.yaml"
    assert whence["rig_file"] == "rig_demo_quick.yaml"
    assert "serial" in whence["camera"]
    assert None not in whence.values()
    assert page.stat().st_size < 6e6
    data = held(page)
    assert data["scans"] == done.json["scans"]
    assert data["provenance"] == done.json["provenance"]


def test_a_comparison_has_a_page(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    page, scan = tmp_path / "c.html", demo.folder / "pyramid"
    words = ("compare", scan / "cloud.ply", scan / "truth.stl", "--align", "--report", page, "--json")
    done = fpplab(*words)
    assert done.code == 0, done.err
    assert done.json["report"] == str(page)
    data = held(page)
    assert data["surface_rms_um"] == done.json["surface_rms_um"]
    text = page.read_text(encoding="utf-8")
    assert "from the true shape" in text
    assert "The scan itself" in text
    again = fpplab(*words)
    assert again.code == 2
    assert "exists already" in again.json["error"]


def test_the_demonstrations_page_is_small_enough_to_mail(demo: Demo) -> None:
    page = Path(demo.answer["report"])
    assert page.stat().st_size < 6e6
    assert page.read_text(encoding="utf-8").count('class="verdict unverified"') == 3


def test_wrong_use_of_report_is_told(fpplab: Command, tmp_path: Path) -> None:
    for name in "ab":
        (tmp_path / name).mkdir()
    for words, said, code in (
        ((tmp_path / "a", "--out", tmp_path / "x.html"), "2 to 8", 2),
        ((tmp_path / "a", tmp_path / "b", "--out", tmp_path / "x.pdf"), ".html", 2),
        ((tmp_path / "a", tmp_path / "c", "--out", tmp_path / "x.html"), "there is no such file", 4),
    ):
        done = fpplab("report", *words, "--json")
        assert done.code == code
        assert said in done.json["error"]
