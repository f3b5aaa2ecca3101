"""A bench's sheet and surroundings are found from recordings of its board, and proven in a pose left out."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from PIL import Image as Pillow

from fpplab.calibration.model import Calibration
from fpplab.characterisation import Characterisation
from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.pipeline.taking import take_poses
from fpplab.sessions.session import recorded_sessions
from sim.matching.reference import Reference
from sim.matching.scene.appearance import AppearanceTrial, match_appearance
from sim.twin import Twin
from sim.worker import Blender
from sim.world import World
from tests.sim.conftest import plain
from tests.sim.test_surroundings import WALL, write_wall

pytestmark = pytest.mark.nightly
SIZE = (456, 304)
MARGINS, RIM = (9.0, 4.0, 6.0, 3.0), 7.0
PLAN = Plan(fringes=tuple(Sinusoid(axis=axis, stripes=s, steps=4) for axis in ("x", "y") for s in (1, 8, 32)))
POSES = [
    {"rotation_deg": turn, "translation_mm": place}
    for turn, place in (
        ([5, -8, 2], [-22, -8, 430]),
        ([-12, 10, -3], [18, 6, 450]),
        ([14, 6, 5], [-4, 12, 440]),
        ([-6, -14, 0], [10, -12, 455]),
    )
]


def world(folder: Path, **board: Any) -> World:
    data = plain(render={"subpixels": 2, "computed_subpixels": 2, "cache": False}, ambient=0.0)
    data["camera"] |= {"sensor_size": SIZE, "pixel_um": 13132.8 / SIZE[0]}
    data["projector"]["leds"] = {"green": {"lumens": 0.6, "wavelength_nm": 525}}
    data["items"] = {"board": {"target": "target_paper.yaml", "poses": POSES, **board}}
    return config.validate(data, World, "test")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> tuple[World, Path]:
    """A bench with a wall, a wide sheet of uneven print, and a frame; recorded in four poses."""
    folder = tmp_path_factory.mktemp("bench")
    random = np.random.default_rng(4)
    coarse = random.normal(1.0, 0.08, (12, 18))
    Pillow.fromarray(np.clip(np.rint(128 * coarse), 0, 255).astype(np.uint8)).save(folder / "texture.png")
    of = world(folder, margins_mm=MARGINS, rim_mm=RIM, texture=str(folder / "texture.png"))
    section = write_wall(folder, 0.4, 260.0)
    shades = np.full(SIZE[::-1], 255, np.uint8)
    shades[:, SIZE[0] // 2 :] = 150
    Pillow.fromarray(shades).save(folder / "wall.png")
    data = of.model_dump(mode="json") | {"surroundings": section}
    (folder / "world.yaml").write_text(config.to_yaml(data), encoding="utf-8")
    devices = {name: {"backend": f"virtual_{name}"} for name in ("camera", "projector", "fixture")}
    rig = {"name": "Bench", "bench": {"backend": "virtual_bench", "world": "world.yaml", "analytic": True}}
    (folder / "rig.yaml").write_text(config.to_yaml({**rig, **devices}), encoding="utf-8")
    with Rig.load(folder / "rig.yaml") as opened:
        take_poses(opened, PLAN, "board", len(POSES), folder / "poses", replace_existing=False)
    return World.load(folder / "world.yaml"), folder


def reference_of(bench: World, folder: Path, twin: Twin) -> Reference:
    known = Calibration(bench.camera_model(), bench.projector_model(), bench.T_projector_camera(), {})
    found = SimpleNamespace(calibration=known, poses=twin.parameters.poses)
    sessions = tuple(recorded_sessions([folder / "poses"]))
    return Reference(sessions, twin.target, cast(Characterisation, found))


@pytest.fixture(scope="module")
def matched(bench: tuple[World, Path]) -> tuple[Twin, AppearanceTrial]:
    of, folder = bench
    twin = Twin.of(world(folder), "board", Blender("bench"))
    return twin, match_appearance(reference_of(of, folder, twin), twin)


def test_both_parts_prove_themselves(matched: tuple[Twin, AppearanceTrial]) -> None:
    _, found = matched
    assert found.sheet.accepted
    assert found.surroundings.accepted
    assert found.surroundings.ssim_with > 0.9
    assert found.summary()["surroundings"]["faces"] > 1000


def test_margins_and_frame_are_found(matched: tuple[Twin, AppearanceTrial]) -> None:
    sheet = matched[1].appearance.sheet
    np.testing.assert_allclose(sheet.margins_mm, MARGINS, atol=1.0)
    assert sheet.rim_mm == pytest.approx(RIM, abs=1.5)


def test_the_texture_is_the_bench_s(bench: tuple[World, Path], matched: tuple[Twin, AppearanceTrial]) -> None:
    sheet = matched[1].appearance.sheet
    assert sheet.texture is not None
    true = np.asarray(Pillow.open(bench[1] / "texture.png"), np.float32) / 128
    shown = np.asarray(
        Pillow.fromarray(true).resize(sheet.texture.shape[::-1], Pillow.Resampling.BILINEAR), np.float64
    )
    inner = np.s_[8:-8, 8:-8]
    assert np.corrcoef(sheet.texture[inner].ravel(), shown[inner].ravel())[0, 1] > 0.918
    assert float(np.median(sheet.texture[inner] / shown[inner])) == pytest.approx(1.0, abs=0.02)


def test_the_wall_is_where_it_stands(matched: tuple[Twin, AppearanceTrial]) -> None:
    around = matched[1].appearance.surroundings
    assert around is not None
    off: Floats = WALL.inverse().apply(np.asarray(around.mesh.vertices))[:, 2]
    assert np.median(np.abs(off)) < 0.5
    assert np.quantile(np.abs(off), 0.95) < 3.0


def test_the_wall_reflects_as_it_does(matched: tuple[Twin, AppearanceTrial]) -> None:
    around = matched[1].appearance.surroundings
    assert around is not None
    left, right = around.reflectance[:, : SIZE[0] // 2 - 8], around.reflectance[:, SIZE[0] // 2 + 8 :]
    assert float(np.median(left[left > 0])) == pytest.approx(0.4, rel=0.04)
    assert float(np.median(right[right > 0])) == pytest.approx(0.4 * 150 / 255, rel=0.04)


def test_nothing_is_added_where_there_is_nothing(tmp_path: Path) -> None:
    """A bench that is its twin: no sheet beyond the target, no surroundings."""
    of = world(tmp_path)
    (tmp_path / "world.yaml").write_text(config.to_yaml(of.model_dump(mode="json")), encoding="utf-8")
    devices = {name: {"backend": f"virtual_{name}"} for name in ("camera", "projector", "fixture")}
    rig = {"name": "Bench", "bench": {"backend": "virtual_bench", "world": "world.yaml", "analytic": True}}
    (tmp_path / "rig.yaml").write_text(config.to_yaml({**rig, **devices}), encoding="utf-8")
    with Rig.load(tmp_path / "rig.yaml") as opened:
        take_poses(opened, PLAN, "board", 2, tmp_path / "poses", replace_existing=False)
    twin = Twin.of(of, "board", Blender("bench"))
    twin = twin.with_parameters(replace(twin.parameters, poses=twin.parameters.poses[:2]))
    found = match_appearance(reference_of(of, tmp_path, twin), twin)
    assert not found.sheet.accepted
    assert not found.surroundings.accepted
    assert found.appearance.surroundings is None
    assert found.appearance.sheet.texture is None
