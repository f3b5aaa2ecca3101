"""Reference marks from printing to correction, on the twin: they stand in view behind what is scanned."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from fpplab.core import config
from tests.support.commands import Command, Demo

pytestmark = pytest.mark.whole

MARKS = {
    "target": "target_marks.yaml",
    "poses": [{"rotation_deg": [4, -3, 1], "translation_mm": [0, 0, 535]}],
}
FRINGES = [
    {"axis": axis, "stripes": n, "steps": steps} for axis in "xy" for n, steps in ((1, 4), (8, 4), (64, 8))
]


@dataclass(frozen=True)
class Bench:
    """The demonstration's bench with marks, and its calibration, which has them located."""

    folder: Path
    fpplab: Command

    @property
    def calibration(self) -> Path:
        return self.folder / "calibration.yaml"

    def set_up(self, turned_deg: float, axes: str = "xy") -> None:
        """Write world, rig and plan, with the projector turned about its upright axis."""
        world = yaml.safe_load(config.find_config("world_demo.yaml").read_text())
        world["items"]["marks"], world["standing"] = MARKS, ["marks"]
        world["items"]["part"] = {
            "card_mm": [90, 60],
            "pose": {"rotation_deg": [12, -9, 0], "translation_mm": [0, 0, 455]},
        }
        world["projector"]["T_camera_projector"]["rotation_deg"][1] += turned_deg
        rig = yaml.safe_load(config.find_config("rig_demo_quick.yaml").read_text())
        plan = {"fringes": [f for f in FRINGES if f["axis"] in axes], "exposure_s": 0.02}
        rig["bench"]["world"] = "world.yaml"
        for file, content in (("world", world), ("rig", rig), ("plan", plan)):
            (self.folder / f"{file}.yaml").write_text(yaml.safe_dump(content))

    def scan(self, name: str, turned_deg: float = 0.0, axes: str = "xy") -> Path:
        self.set_up(turned_deg, axes)
        out, given = self.folder / name, self.folder / "plain.yaml"
        options = ["--rig", self.folder / "rig.yaml", "--plan", self.folder / "plan.yaml", "--item", "part"]
        done = self.fpplab("scan", *options, "--calibration", given, "--out", out)
        assert done.code == 0, done.err
        return out

    def judged(self, scan: Path, calibration: Path) -> dict[str, Any]:
        out = self.folder / "cloud.ply"
        done = self.fpplab(
            "reconstruct", scan, "--calibration", calibration, "--out", out, "--json", "--force"
        )
        assert done.code == (4 if done.json["verdict"] == "useless" else 0), done.err
        return done.json


@pytest.fixture(scope="module")
def bench(fpplab: Command, demo: Demo, tmp_path_factory: pytest.TempPathFactory) -> Bench:
    bench = Bench(tmp_path_factory.mktemp("marks"), fpplab)
    (bench.folder / "plain.yaml").write_bytes((demo.folder / "calibration.yaml").read_bytes())
    seen = bench.scan("located")
    poses = [demo.folder / "board", "--target", "target_paper", "--marks", seen]
    done = fpplab("characterise", *poses, "--out", bench.calibration)
    assert done.code == 0, done.err
    return bench


@pytest.mark.parametrize("axes", ["xy", "x"])
def test_scans_of_a_rig_that_is_as_it_was_are_good(bench: Bench, axes: str) -> None:
    judged = bench.judged(bench.scan(f"as_it_was_{axes}", axes=axes), bench.calibration)
    assert judged["verdict"] == "good"
    assert judged["unverified"] == []


def test_a_turned_projector_is_shown_and_corrected(bench: Bench) -> None:
    scan, new = bench.scan("turned", turned_deg=0.1), bench.folder / "corrected.yaml"
    judged = bench.judged(scan, bench.calibration)
    assert judged["verdict"] == "useless"
    (finding,) = judged["findings"]
    assert finding["cause"] == "stale_calibration"
    assert "projector or camera moved" in finding["evidence"]
    done = bench.fpplab("characterise", "--correct", bench.calibration, scan, "--out", new, "--json")
    assert done.code == 0, done.err
    assert done.json["probabilities"]["projector or camera moved"] > 0.99
    assert bench.judged(bench.scan("later", turned_deg=0.1), new)["verdict"] == "good"


@pytest.mark.parametrize("turned_deg", [0.0, 0.1])
def test_one_pose_of_the_board_confirms_or_corrects(bench: Bench, turned_deg: float) -> None:
    bench.set_up(turned_deg)
    known, folder = bench.folder / "checked.yaml", bench.folder / f"board_{turned_deg:g}"
    known.write_bytes((bench.folder / "plain.yaml").read_bytes())
    options = ["--rig", bench.folder / "rig.yaml", "--calibration", known, "--board", folder]
    done = bench.fpplab("check", *options, "--json")
    assert done.code == (3 if turned_deg else 0), done.err
    assert done.json["contradicted"] is bool(turned_deg)
    assert ("now records that these poses confirm it" in done.err) is not bool(turned_deg)
    if turned_deg:
        assert done.json["corrected"]["probabilities"]["projector or camera moved"] > 0.99
        assert (
            bench.judged(bench.scan("checked", turned_deg), folder / "corrected.yaml")["verdict"] != "useless"
        )


def test_a_scan_without_marks_cannot_locate_them(bench: Bench, demo: Demo) -> None:
    poses = [demo.folder / "board" / f"pose_{k:02d}" for k in range(4)]
    given = [*poses, "--target", "target_paper", "--marks", poses[0]]
    done = bench.fpplab("characterise", *given, "--out", bench.folder / "other.yaml", "--json")
    assert done.code == 5
    assert "pose_00: 0 points of reference marks found (at least 6)" in done.json["error"]
    assert not (bench.folder / "other.yaml").exists()
