"""Captures of a real LightCrafter 4500 and one camera, from images to characterisation and cloud."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.system.conftest import Command


@pytest.fixture(scope="module")
def calibration(
    fpplab: Command, captures: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, dict]:  # type: ignore[type-arg]
    """The five board poses imported and characterised."""
    folder = tmp_path_factory.mktemp("captures")
    for k in range(1, 6):
        done = fpplab(
            "import", captures / f"calseq{k}", "--plan", "plan_slstudio_board", "--frames", "{index:02d}.png",
            "--out", folder / "board" / f"calseq{k}", "--json",
        )  # fmt: skip
        assert done.code == 0, done.err
        assert done.json["frames"] == 12
    done = fpplab(
        "characterise", folder / "board", "--target", "target_slstudio", "--out", folder / "c.yaml", "--json"
    )
    assert done.code == 0, done.err
    return folder / "c.yaml", done.json


def test_five_poses_are_characterised(calibration: tuple[Path, dict]) -> None:  # type: ignore[type-arg]
    _, found = calibration
    assert found["poses"] == 5
    assert not found["left_out"]
    assert found["camera"]["rms_px"] <= 0.10
    assert found["projector"]["rms_px"] <= 0.11
    assert found["stereo_rms_px"] <= 0.36
    assert found["joint_rms_px"] <= 0.11
    assert max(found["leave_one_out"].values()) <= 0.20
    assert found["model"] == "tangential"
    assert [m["model"] for m in found["models"]] == ["tangential"]
    assert 0 < found["rejected"] < 20
    assert len(found["warnings"]) == 1


def test_a_board_taken_as_flat(fpplab: Command, calibration: tuple[Path, dict]) -> None:  # type: ignore[type-arg]
    folder = calibration[0].parent
    done = fpplab(
        "characterise", folder / "board", "--target", "target_slstudio", "--out", folder / "flat.yaml",
        "--flat-board", "--model", "auto", "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert done.json["model"] == "k1"
    assert [m["model"] for m in done.json["models"]] == ["k1", "k2", "tangential", "k3"]
    assert done.json["leave_one_out"]["camera_px"] <= 0.33
    assert done.json["leave_one_out"]["projector_px"] <= 0.40
    assert "warning: no point of a board lay in this part of the camera's image" in done.err
    page = (folder / "flat.html").read_text()
    assert "k1: distortion k1" in page
    assert "point 109 lies" in page


def test_the_skull_is_reconstructed(
    fpplab: Command,
    captures: Path,
    calibration: tuple[Path, dict],  # type: ignore[type-arg]
    tmp_path: Path,
) -> None:
    from fpplab.clouds import load_cloud, local_quadric_distance

    skull = tmp_path / "skull"
    done = fpplab(
        "import", captures / "skull_2x3", "--plan", "plan_slstudio_skull", "--frames", "{index:02d}.png",
        "--out", skull, "--json",
    )  # fmt: skip
    assert done.code == 0, done.err
    done = fpplab(
        "reconstruct", skull, "--calibration", calibration[0], "--out", skull / "cloud.ply", "--json"
    )
    assert done.code == 0, done.err
    assert done.json["points"] >= 380_000
    distance = local_quadric_distance(load_cloud(skull / "cloud.ply"))
    assert np.nanmedian(np.abs(distance)) <= 0.12
