"""The acceptance test on the virtual bench, whose standards and calibration are exactly known."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import yaml

from fpplab.calibration.model import Calibration
from sim.world import World
from tests.support.commands import NO_DISPLAY, ROOT, Command
from tests.support.recordings import Recording

BARS, PLANES = ("ball_bar_2", "ball_bar_3"), ("plane_4",)


@dataclass(frozen=True)
class Bench:
    """What the test on the bench left, and with what it was made."""

    folder: Path
    standard: Path
    calibration: Path
    answer: dict[str, Any]


pytestmark = pytest.mark.whole


@pytest.fixture(scope="module")
def bench(fpplab: Command, tmp_path_factory: pytest.TempPathFactory) -> Bench:
    """`fpplab verify --rig` in three positions, with the true calibration."""
    folder = tmp_path_factory.mktemp("verify")
    document = yaml.safe_load((ROOT / "configs" / "standard_demo.yaml").read_text())
    document["items"] = {"ball_bar": list(BARS), "plane": list(PLANES)}
    standard, calibration = folder / "standard.yaml", folder / "calibration.yaml"
    standard.write_text(yaml.safe_dump(document))
    world = World.load("world_demo.yaml").binned(8)
    truth = Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(), {})
    truth.save(calibration)
    done = fpplab(
        "verify", "--standard", standard, "--rig", "rig_demo_quick", "--calibration", calibration,
        "--out", folder / "verify.html", "--view", "--json", env=NO_DISPLAY,
    )  # fmt: skip
    assert done.code == 0, done.err
    return Bench(folder, standard, calibration, done.json)


def test_an_item_that_is_no_folder_on_windows_is_refused(
    fpplab: Command, bench: Bench, tmp_path: Path
) -> None:
    document = yaml.safe_load(bench.standard.read_text())
    (tmp_path / "standard.yaml").write_text(yaml.safe_dump({**document, "items": {"plane": ["aux"]}}))
    done = fpplab(
        "verify", "--standard", tmp_path / "standard.yaml", "--rig", "rig_demo_quick",
        "--calibration", bench.calibration, "--out", tmp_path / "verify.html",
    )  # fmt: skip
    assert done.code == 2
    assert "'items' names 'aux'" in done.err


def test_positions_and_the_fits_errors_were_shown(bench: Bench) -> None:
    shown = Recording(bench.folder / "verify.rrd")
    assert shown.frames("world/camera/image")
    assert len(shown.value("world/coloured/Error", "Position3D")) > 1000
    assert "PF" in shown.value("words/result", "Text")


def test_a_bench_of_known_geometry_errs_by_its_noise_alone(bench: Bench) -> None:
    found = bench.answer
    assert found["passed"] is True
    assert [s["source"] for s in found["spheres"]] == [bar for bar in BARS for _ in range(2)]
    for test in [*found["spheres"], *found["planes"]]:
        name = "PF" if "PF_um" in test else "F"
        form = test[f"{name}_um"]
        assert test[f"{name}_all_um"] > form
        assert 4 * test["rms_um"] < form < 12 * test["rms_um"]
        assert test["rms_um"] < 15
        assert test["discarded"] == test["points"] * 3 // 1000
    for sphere in found["spheres"]:
        assert abs(sphere["PS_um"]) < 10
        assert sphere["solid_angle_sr"] > 2.5
    for spacing in found["spacings"]:
        assert abs(spacing["SD_um"]) < 5
    assert found["planes"][0]["area_mm2"] > 0.9 * 140 * 90


def test_too_few_positions_are_told(bench: Bench) -> None:
    assert any("SD: measured in 2 of at least 7" in notice for notice in bench.answer["notices"])
    assert any("F: measured in 1 of at least 6" in notice for notice in bench.answer["notices"])


def test_the_report_shows_every_position(bench: Bench) -> None:
    page = Path(bench.answer["report"]).read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == len(BARS) + len(PLANES)
    assert "Probing error, form PF" in page
    assert 'id="provenance"' in page
    assert set(bench.answer["provenance"]) == {*BARS, *PLANES}
    assert all(one["calibration"] and one["camera"] for one in bench.answer["provenance"].values())
    assert "://" not in page


def test_recorded_sessions_and_clouds_give_the_same(fpplab: Command, bench: Bench) -> None:
    scans = bench.folder / "verify_scans"
    bars = [scans / BARS[0], scans / BARS[1] / "cloud.ply"]
    words = ["verify", "--standard", bench.standard, "--spheres", *bars, "--planes", scans / PLANES[0]]
    done = fpplab(*words, "--out", bench.folder / "again.html", "--json")
    assert done.code == 0, done.err
    assert done.json["quantities"] == bench.answer["quantities"]


def test_an_acceptance_that_fails_is_a_result(fpplab: Command, bench: Bench) -> None:
    scan = bench.folder / "verify_scans" / BARS[0]
    words = ["verify", "--standard", bench.standard, "--spheres", scan, "--calibration", bench.calibration]
    done = fpplab(*words, "--mpe", "PF=5", "--out", bench.folder / "strict.html", "--json")
    assert done.code == 0, done.err
    assert done.json["passed"] is False
    assert done.json["quantities"]["PF"]["passed"] is False
    assert done.json["quantities"]["SD"]["passed"] is True


def test_a_plane_is_no_ball_bar(fpplab: Command, bench: Bench) -> None:
    scan = bench.folder / "verify_scans" / PLANES[0]
    out = bench.folder / "wrong.html"
    done = fpplab("verify", "--standard", bench.standard, "--spheres", scan, "--out", out, "--json")
    assert done.code == 4
    assert f"{scan}: 0 of 2 spheres of 20 mm were found" in done.json["error"]
    assert not out.exists()
