"""The demonstration, and every command on what it leaves."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image as Pillow

from fpplab import Decoded, Session, compare, decode, load_cloud, load_mesh
from tests.support.commands import Command, Demo

COMPARED = {"smcd_um", "smcd_floor_um", "surface_smcd_um", "completeness"}
ARTEFACTS = ("pyramid", "pillars", "steps")


def test_demo_answers_every_key_of_the_design(demo: Demo) -> None:
    keys = {"gamma", "characterisation", "scans", "mean_surface_smcd_um", "seconds", "report"}
    assert keys <= demo.answer.keys()
    scan_keys = {"artefact", "images", "points", "surface_rms_um", *COMPARED}
    for scan in demo.answer["scans"]:
        assert scan_keys <= scan.keys()
    assert [s["artefact"] for s in demo.answer["scans"]] == list(ARTEFACTS)


def test_demo_characterises_and_measures_truly(demo: Demo) -> None:
    found = demo.answer["characterisation"]
    assert found["camera"]["rms_px"] <= 0.06
    assert found["projector"]["rms_px"] <= 0.08
    for scan in demo.answer["scans"]:
        assert scan["surface_rms_um"] <= 60.0, scan
        assert scan["completeness"] >= 0.9, scan
        assert scan["smcd_um"] >= scan["smcd_floor_um"] > 0


def test_demo_finds_the_response_that_the_world_has(demo: Demo) -> None:
    gamma = demo.answer["gamma"]
    assert gamma["g"] == pytest.approx(1.0, abs=max(0.01, 3 * gamma["sigma"][2]))


def test_demo_report_stands_alone(demo: Demo) -> None:
    page = Path(demo.answer["report"]).read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") >= 24
    assert "http://" not in page
    assert "https://" not in page
    for name in ARTEFACTS:
        assert name in page


def test_demo_refuses_to_replace_without_force(fpplab: Command, demo: Demo) -> None:
    again = fpplab("demo", "--quick", "--json", "--out", demo.folder)
    assert again.code == 2
    assert "--force" in again.json["error"]


def test_decode_gives_maps(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    done = fpplab("decode", demo.folder / "pyramid", "--out", tmp_path / "x.npz", "--json")
    assert done.code == 0, done.err
    maps = np.load(tmp_path / "x.npz")
    assert {"u", "v", "modulation", "sigma"} <= set(maps.files)
    assert maps["u"].dtype == np.float32
    assert int(np.isfinite(maps["u"]).sum()) == done.json["valid"] > 1000


@pytest.mark.parametrize(
    "suffix", [".ply", *(pytest.param(other, marks=pytest.mark.whole) for other in (".xyz", ".npz"))]
)
def test_reconstruct_again_gives_the_scan_s_points(
    fpplab: Command, demo: Demo, tmp_path: Path, suffix: str
) -> None:
    out = tmp_path / f"cloud{suffix}"
    calibration = demo.folder / "calibration.yaml"
    done = fpplab("reconstruct", demo.folder / "steps", "--calibration", calibration, "--out", out, "--json")
    assert done.code == 0, done.err
    assert done.json["points"] == demo.answer["scans"][2]["points"]
    again = fpplab("reconstruct", demo.folder / "steps", "--calibration", calibration, "--out", out, "--json")
    assert again.code == 2


def test_compare_gives_the_demo_s_figures(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    scan = demo.folder / "pyramid"
    picture = tmp_path / "errors.png"
    done = fpplab("compare", scan / "cloud.ply", scan / "truth.stl", "--align", "--out", picture, "--json")
    assert done.code == 0, done.err
    assert {"surface_rms_um", "surface_p95_um", "outliers", *COMPARED} <= done.json.keys()
    expected = demo.answer["scans"][0]["surface_rms_um"]
    assert done.json["surface_rms_um"] == pytest.approx(expected, rel=0.02)
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_characterise_from_recorded_sessions(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    out = tmp_path / "again.yaml"
    done = fpplab("characterise", demo.folder / "board", "--target", "target_paper", "--out", out, "--json")
    assert done.code == 0, done.err
    keys = {"camera", "projector", "joint_rms_px", "leave_one_out", "poses", "points"}
    assert keys <= done.json.keys()
    again, before = (yaml.safe_load(p.read_text()) for p in (out, demo.folder / "calibration.yaml"))
    assert again.pop("origin").keys() == before.pop("origin").keys()  # which says when it was made
    for found in (again, before):
        assert len(found.pop("checksum")) == 64  # of the numbers to their last digit, which differs
    # The order in which threads add up is not the same every time.
    expected = {
        place: pytest.approx(one, rel=1e-4, abs=1e-8) if isinstance(one, float) else one
        for place, one in leaves(before).items()
    }
    assert leaves(again) == expected


def leaves(tree: Any, name: str = "") -> dict[str, Any]:
    """All values of nested mappings and lists by their places."""
    if not isinstance(tree, dict | list):
        return {name: tree}
    parts = tree.items() if isinstance(tree, dict) else enumerate(tree)
    return {place: leaf for key, one in parts for place, leaf in leaves(one, f"{name}/{key}").items()}


@pytest.fixture(scope="module")
def scan_of_nothing(fpplab: Command, demo: Demo, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session of a card without a board; nobody changes it."""
    out = tmp_path_factory.mktemp("nothing") / "card"
    done = fpplab(
        "scan", "--rig", "rig_demo_quick", "--plan", "plan_board", "--item", "grey_card",
        "--calibration", demo.folder / "calibration.yaml", "--out", out,
    )  # fmt: skip
    assert done.code == 0, done.err
    return out


@pytest.mark.whole
def test_a_session_without_its_board_is_named_and_left_out(
    fpplab: Command, demo: Demo, scan_of_nothing: Path, tmp_path: Path
) -> None:
    poses = tmp_path / "poses"
    shutil.copytree(scan_of_nothing, poses / "pose_00")
    for k in range(1, 4):
        shutil.copytree(demo.folder / "board" / f"pose_{k:02d}", poses / f"pose_{k:02d}")
    done = fpplab("characterise", poses, "--target", "target_paper", "--out", tmp_path / "c.yaml", "--json")
    assert done.code == 0, done.err
    assert list(done.json["left_out"]) == ["pose_00"]
    assert "left out: pose_00" in done.err


@pytest.mark.whole
def test_no_board_in_any_session_is_a_calibration_error(
    fpplab: Command, scan_of_nothing: Path, tmp_path: Path
) -> None:
    sessions = [tmp_path / f"none_{k}" for k in range(3)]
    for copy in sessions:
        shutil.copytree(scan_of_nothing, copy)
    done = fpplab(
        "characterise", *sessions, "--target", "target_paper", "--out", tmp_path / "c.yaml", "--json"
    )
    assert done.code == 5
    assert "(none_0 and 2 more: the board was not found in the image)" in done.json["error"]
    assert not (tmp_path / "c.yaml").exists()


def test_every_scan_runs_from_a_replayed_session(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    rig = {
        "name": "replay",
        "bench": {
            "backend": "fpplab.sessions.replay:RecordedSession",
            "session": str(demo.folder / "pillars"),
        },
        "camera": {"backend": "fpplab.sessions.replay:ReplayCamera"},
        "projector": {"backend": "fpplab.sessions.replay:ReplayProjector"},
    }
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
    done = fpplab(
        "scan", "--rig", tmp_path / "rig.yaml", "--calibration", demo.folder / "calibration.yaml",
        "--out", tmp_path / "again", "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert {"points", "images", "seconds", "cloud"} <= done.json.keys()
    assert done.json["points"] == demo.answer["scans"][1]["points"]


@pytest.mark.whole
def test_loose_images_of_a_diamond_projector_become_a_cloud(
    fpplab: Command, demo: Demo, tmp_path: Path
) -> None:
    """Characterised with some poses and reconstructed, all from image files."""
    for name in [*(f"board/pose_{k:02d}" for k in range(4)), "pyramid"]:
        recorded = Session.open(demo.folder / name)
        folder = tmp_path / "images" / name
        folder.mkdir(parents=True)
        for index, image in enumerate(recorded.stack()):
            Pillow.fromarray(image).save(folder / f"{index}.png")
        done = fpplab(
            "import", folder, "--frames", "*.png", "--plan", demo.folder / name / "plan.yaml",
            "--projector-size", 912, 1140, "--lattice", "diamond", "--out", tmp_path / name, "--json",
        )  # fmt: skip
        assert done.code == 0, done.err
        assert done.json["warnings"] == []
    calibration = tmp_path / "c.yaml"
    done = fpplab("characterise", tmp_path / "board", "--target", "target_paper", "--out", calibration)
    assert done.code == 0, done.err
    cloud = tmp_path / "cloud.ply"
    done = fpplab("reconstruct", tmp_path / "pyramid", "--calibration", calibration, "--out", cloud)
    assert done.code == 0, done.err
    found = compare(load_cloud(str(cloud)), load_mesh(str(demo.folder / "pyramid" / "truth.stl")), align=True)
    assert found.surface_rms_um <= 60.0
    assert found.completeness >= 0.9
    fpplab(
        "import", folder, "--frames", "*.png", "--plan", demo.folder / "pyramid" / "plan.yaml",
        "--projector-size", 912, 1140, "--lattice", "square", "--out", tmp_path / "square",
    )  # fmt: skip
    done = fpplab(
        "reconstruct", tmp_path / "square", "--calibration", calibration, "--out", tmp_path / "s.ply"
    )
    assert done.code == 5
    assert "import images from elsewhere with '--lattice diamond'" in done.err


def test_view_writes_a_recording(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    out = tmp_path / "s.rrd"
    done = fpplab("view", demo.folder / "pyramid", "--out", out, "--json")
    assert done.code == 0, done.err
    assert out.stat().st_size > 100_000


CODES = """
fringes:
  - {kind: even, levels: [1, 0]}
  - {kind: gray, axis: x, bits: 10}
  - {kind: gray, axis: y, bits: 11}
"""


def test_a_scan_by_gray_codes_gives_the_points_of_fringes(
    fpplab: Command, demo: Demo, tmp_path: Path
) -> None:
    """On a diamond lattice, whose second rows show the edges of columns half a column further."""
    (tmp_path / "codes.yaml").write_text(CODES)
    scanned = fpplab(
        "scan", "--rig", "rig_demo_quick", "--item", "pyramid", "--plan", tmp_path / "codes.yaml",
        "--calibration", demo.folder / "calibration.yaml", "--out", tmp_path / "codes", "--json",
    )  # fmt: skip
    assert scanned.code == 0, scanned.err
    assert scanned.json["verdict"] == "unverified"
    assert any("only fringes show flicker" in text for text in scanned.json["unverified"])
    codes = decode(Session.open(tmp_path / "codes").recording())
    fringes = Decoded.load(demo.folder / "pyramid" / "decoded.npz")
    both = codes.valid & fringes.valid
    assert both.sum() > 0.9 * fringes.valid.sum()
    off = ((codes.u - fringes.u) / np.hypot(codes.sigma, fringes.sigma_total))[both]
    assert abs(np.median(off)) < 0.2
    assert np.median(np.abs(off)) / 0.6745 < 1.3
