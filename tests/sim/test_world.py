"""The world file and what follows from it without rendering."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fpplab.calibration.model import Calibration, CalibrationFile
from fpplab.core import config
from fpplab.core.conventions import Lattice
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import RigidTransform
from fpplab.targets import Target
from sim.build import SceneState, build_scene
from sim.items import item_poses
from sim.world import Binning, World
from tests.sim.conftest import plain, world, write_world


@pytest.mark.parametrize(("binning", "size"), [(4, (1368, 912)), (8, (684, 456)), (1, (5472, 3648))])
def test_the_world_of_the_demonstration_is_as_described(binning: Binning, size: tuple[int, int]) -> None:
    of = World.load("world_demo.yaml").binned(binning)
    assert of.camera_model().size == size
    corners = np.array([[-0.5, -0.5], [size[0] - 0.5, size[1] - 0.5]])
    plain_camera = of.model_copy(update={"camera": of.camera.model_copy(update={"distortion": (0.0,) * 5})})
    field = 450 * np.diff(plain_camera.camera_model().normalise(corners), axis=0)[0]
    np.testing.assert_allclose(field, [168.8, 112.6], atol=0.1)
    projector = of.projector_model()
    assert projector.matrix[1, 1] == 2 * projector.matrix[0, 0] == pytest.approx(2 * 1.2 * 912)
    assert np.linalg.norm(of.T_projector_camera().translation) == pytest.approx(150)


def test_a_binned_world_is_the_same_but_for_its_pixels() -> None:
    world = World.load("world_demo.yaml")
    full, quick = world.model_dump(), world.binned(8).model_dump()
    assert (full["camera"].pop("binning"), quick["camera"].pop("binning")) == (4, 8)
    assert full == quick


@pytest.mark.parametrize("depth", [425.0, 475.0])
def test_the_whole_field_of_the_demonstration_is_lit(depth: float) -> None:
    """At every stop of the stage, with room to spare."""
    of = World.load("world_demo.yaml")
    width, height = of.camera.size
    v, u = np.mgrid[0 : height - 1 : 20j, 0 : width - 1 : 20j]
    rays = np.concatenate([of.camera_model().normalise(np.stack([u, v], -1)), np.ones((20, 20, 1))], axis=-1)
    for stage in of.stage.travel_mm:
        pixels = of.projector_model().project(depth * rays, of.T_projector_camera(stage))
        assert pixels.min() > 10
        assert (pixels.max(axis=(0, 1)) < np.array(of.projector.size) - 10).all()


def test_axis_x_of_the_demonstration_measures_depth() -> None:
    """A point that moves in depth moves along u, hardly along v, whose rows lie half as far apart."""
    of = World.load("world_demo.yaml")
    points = np.array([[0.0, 0.0, 450.0], [0.0, 0.0, 451.0]])
    step = np.diff(of.projector_model().project(points, of.T_projector_camera()), axis=0)[0]
    assert abs(step[0]) > 0.7
    assert abs(step[1]) / 2 < 0.1 * abs(step[0])


def test_binned_pixels_lie_on_the_same_sensor() -> None:
    """The centre of a binned pixel is the mean of the centres that it is made of."""
    cameras = {}
    for binning in (1, 4):
        data = plain()
        data["camera"] = {**data["camera"], "sensor_size": [192, 128], "binning": binning}
        cameras[binning] = config.validate(data, World, "test").camera_model()
    point = np.array([[12.0, -7.0, 450.0]])
    fine, coarse = (cameras[b].project(point)[0] for b in (1, 4))
    np.testing.assert_allclose(coarse, (fine - 1.5) / 4, atol=1e-9)


def test_stage_moves_the_projector_along_its_axis() -> None:
    of = world(stage={"axis": [2, 0, 0]})
    centres = [of.T_projector_camera(mm).inverse().translation for mm in (0.0, 10.0)]
    np.testing.assert_allclose(centres[1] - centres[0], [10, 0, 0], atol=1e-9)


def test_board_poses_are_reproducible_spread_and_in_view() -> None:
    of = World.load("world_demo.yaml")
    poses = item_poses(of, "board")
    assert len(poses) == 15
    size = Target.load("target_paper.yaml").size_mm
    corners = np.array([[x, y, 0.0] for x in (-0.5, 0.5) for y in (-0.5, 0.5)]) * [*size, 1]
    for pose in poses:
        seen = pose.apply(corners)
        for device, points in (
            (of.camera_model(), seen),
            (of.projector_model(), of.T_projector_camera().apply(seen)),
        ):
            pixels = device.project(points)
            assert (pixels > 0).all()
            assert (pixels < np.array(device.size) - 1).all()
        assert np.degrees(np.arccos(pose.rotation[2, 2])) <= 30.001
        assert abs(pose.translation[2] - 450) <= 25
    centres = np.array([pose.translation for pose in poses])
    assert np.ptp(centres[:, 0]) > 70
    assert np.ptp(centres[:, 1]) > 40
    again = item_poses(of.binned(8), "board")
    other = item_poses(of.model_copy(update={"seed": 2}), "board")
    assert len(again) == len(other) == 15
    for one, two in zip(poses, other, strict=True):
        assert not np.allclose(one.translation, two.translation)
    once_more = item_poses(World.load("world_demo.yaml"), "board")
    np.testing.assert_array_equal([p.matrix for p in once_more], [p.matrix for p in poses])


@pytest.mark.whole
def test_a_board_that_does_not_fit_is_refused() -> None:
    data = plain()
    data["items"]["board"]["poses"] = {"count": 1, "distance_mm": 100.0, "range_mm": 0.0}
    with pytest.raises(ConfigError, match="hardly any lie in the camera's image"):
        item_poses(config.validate(data, World, "test"), "board")


@pytest.mark.parametrize(
    ("section", "fields", "said"),
    [
        ("camera", {"binning": 3}, "binning"),
        ("camera", {"binning": 8, "sensor_size": [100, 100]}, "must divide"),
        ("projector", {"blur": 0.1}, "must be 0 .ideal mirrors. or at least 0.25"),
        ("projector", {"response": {"a": 0.9, "b": 0.2, "g": 1.0}}, "at most 1"),
        ("render", {"path": "transport", "bounces": 1}, "supports direct light only"),
        ("stage", {"travel_mm": [5.0, 10.0]}, "must contain 0"),
        ("stage", {"axis": [0.0, 0.0, 0.0]}, "must be a direction"),
        ("items", {"nothing": plain()["items"]["card"]}, "empty fixture"),
        ("items", {"cup": {"colour": "red"}}, r"'items\.cup' .*must name a 'target'"),
        ("items", {"cup": "red"}, r"'items\.cup' .*must name a 'target'"),
        ("render", {"sampels": 3}, "unknown key"),
    ],
)  # fmt: skip
def test_wrong_worlds_are_refused(section: str, fields: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        world(**{section: fields})


def test_unknown_artefact_and_target_are_refused() -> None:
    pose = {"rotation_deg": [180, 0, 0], "translation_mm": [0, 0, 460]}
    with pytest.raises(ConfigError, match="no such file"):
        item_poses(world(items={"board": {"target": "target_none.yaml"}}), "board")
    of = world(items={"vase": {"artefact": "vase", "pose": pose}})
    with pytest.raises(ConfigError, match="no artefact 'vase'"):
        build_scene(of, SceneState("vase"))


def _measured(of: World) -> Calibration:
    """What no world says of itself: unequal focal lengths, eight coefficients, a pose of its own."""
    camera, projector = of.camera_model(), of.projector_model()
    matrix = camera.matrix * [[1.01, 1, 1.02], [1, 0.99, 1.01], [1, 1, 1]]
    lens = np.array([-0.1, 0.1, 1e-4, 2e-4, 0.0, 0.05, 0.01, 0.002])
    pose = RigidTransform.from_vectors(np.array([0.2, 0.3, -0.1]), np.array([-140.0, 3.0, 45.0]))
    devices = (
        replace(camera, matrix=matrix, distortion=lens),
        replace(projector, matrix=projector.matrix * 1.0),
    )
    return Calibration(*devices, pose, {"camera": 0.05})


def test_a_calibration_takes_the_place_of_the_nominal_geometry(tmp_path: Path) -> None:
    """Named relative to the world file; the stage moves the projector from there."""
    measured = _measured(world())
    measured.save(tmp_path / "bench.yaml")
    of = World.load(write_world(tmp_path, {**plain(), "calibration": "bench.yaml"}))
    np.testing.assert_allclose(of.camera_model().matrix, measured.camera.matrix, rtol=1e-12)
    np.testing.assert_allclose(of.camera_model().distortion, measured.camera.distortion, rtol=1e-12)
    np.testing.assert_allclose(of.projector_model().matrix, measured.projector.matrix, rtol=1e-12)
    pose, moved = of.T_projector_camera(), of.T_projector_camera(10.0)
    np.testing.assert_allclose(pose.matrix, measured.T_projector_camera.matrix, atol=1e-9)
    np.testing.assert_allclose(
        moved.inverse().translation - pose.inverse().translation, [10, 0, 0], atol=1e-9
    )
    scene = build_scene(of, SceneState("board"))[0]
    np.testing.assert_allclose(scene.camera.matrix, measured.camera.matrix, rtol=1e-12)


def test_a_world_is_saved_and_read_again(tmp_path: Path) -> None:
    of = world(ambient=0.1, items={**plain()["items"], "board": {"target": "target_paper.yaml", "ink": 0.2}})
    assert World.load(of.save(tmp_path / "without")) == of
    assert not (tmp_path / "without/calibration.yaml").exists()
    fitted = of.model_copy(update={"calibration": CalibrationFile.of(_measured(of))})
    path = fitted.save(tmp_path / "with")
    assert config.parse_yaml(path.read_text(), path)["calibration"] == "calibration.yaml"
    assert World.load(path) == fitted


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda c: replace(c, camera=replace(c.camera, size=(96, 64))),
            "camera of 96 x 64: must be 192 x 128",
        ),
        (
            lambda c: replace(c, projector=replace(c.projector, size=(912, 570))),
            "projector of 912 x 570: must be",
        ),
        (
            lambda c: replace(c, projector=replace(c.projector, lattice=Lattice.SQUARE)),
            "on a square lattice: must be diamond",
        ),
        (
            lambda c: replace(c, camera=replace(c.camera, distortion=np.array([-20.0, *[0.0] * 7]))),
            "must leave a ray to every pixel",
        ),
    ],
)
def test_a_calibration_of_another_bench_is_refused(
    tmp_path: Path, change: Callable[[Calibration], Calibration], said: str
) -> None:
    change(_measured(world())).save(tmp_path / "other.yaml")
    with pytest.raises(ConfigError, match=f"world.yaml: 'calibration' .*{said}"):
        World.load(write_world(tmp_path, {**plain(), "calibration": "other.yaml"}))


def test_a_calibration_that_is_not_there_or_no_calibration_is_named(tmp_path: Path) -> None:
    path = write_world(tmp_path, {**plain(), "calibration": "none.yaml"})
    with pytest.raises(ConfigError, match=r"none\.yaml: there is no such file"):
        World.load(path)
    (tmp_path / "none.yaml").write_text("camera: 1")
    with pytest.raises(ConfigError, match=r"none\.yaml: 'camera' is 1"):
        World.load(path)


def test_a_board_has_its_own_reflectances_or_its_target_s() -> None:
    def printed(**own: float) -> tuple[float, float]:
        of = world(items={"board": {"target": "target_paper.yaml", **own}})
        surface = build_scene(of, SceneState("board"))[0].surfaces[0]
        assert surface.picture is not None
        assert (surface.picture.min(), surface.picture.max()) == (0, 255)
        return surface.paint.reflectance, surface.paint.ink

    assert printed() == (0.9, 0.05)
    assert printed(reflectance=0.8) == (0.8, 0.05)
    assert printed(ink=0.1) == (0.9, 0.1)
    with pytest.raises(ConfigError, match=r"'ink' is 0\.3, as 'reflectance' is: must differ"):
        printed(reflectance=0.3, ink=0.3)
    with pytest.raises(ConfigError, match=r"'items\.board\.ink' is 1\.5"):
        printed(ink=1.5)


@pytest.mark.parametrize("name", ["hidden", "twin"])
def test_the_hidden_reference_and_its_twin_look_alike_to_a_session(name: str) -> None:
    """Same sizes, items and number of poses; nothing else need agree."""
    of = World.load(f"world_{name}.yaml")
    assert (of.camera.size, of.projector.size) == ((1368, 912), (912, 1140))
    assert len(item_poses(of, "board")) == 20
    assert {"pyramid", "pillars", "steps", "grey_card"} < set(of.items)


UNCERTAIN = {"projector.blur": 0.05, "camera.sensor.full_well_e": 300.0, "vibration_mm": 0.0}


@pytest.mark.whole
def test_draws_of_a_world_have_its_uncertainty() -> None:
    of = world(uncertainty=UNCERTAIN)
    draws = [of.drawn(n) for n in range(1, 200)]
    assert of.drawn(0) is of
    assert of.drawn(7) == of.drawn(7) != of.drawn(8)
    blur = np.array([one.projector.blur for one in draws])
    well = np.array([one.camera.sensor.full_well_e for one in draws])
    for values, known, sigma in (
        (blur, of.projector.blur, 0.05),
        (well, of.camera.sensor.full_well_e, 300.0),
    ):
        assert abs(values.mean() - known) < 4 * sigma / np.sqrt(len(draws))
        assert values.std() == pytest.approx(sigma, rel=0.2)
    assert abs(np.corrcoef(blur, well)[0, 1]) < 0.3
    assert {one.camera.sensor.read_noise_e for one in draws} == {of.camera.sensor.read_noise_e}


def test_draws_stay_within_what_a_field_allows() -> None:
    of = world(ambient=0.0, uncertainty={"ambient": 0.1})
    ambient = np.array([of.drawn(n).ambient for n in range(1, 40)])
    assert (ambient >= 0).all()
    assert ambient.std() > 0.02
    assert world().drawn(3) == world()


@pytest.mark.parametrize(
    "path", ["projector.blurr", "projector", "camera.focus_mm", "items.board.blur", "path"]
)
def test_an_uncertainty_of_what_is_no_number_is_refused(path: str) -> None:
    with pytest.raises(ConfigError, match=f"names '{path}': must be the path of a number"):
        world(uncertainty={path: 1.0})


def test_a_saved_world_names_what_comes_with_fpplab_by_its_name_alone(tmp_path: Path) -> None:
    """So that it opens with another installation too."""
    World.load("world_paper").save(tmp_path)
    saved = config.parse_yaml((tmp_path / "world.yaml").read_text(), tmp_path)
    assert saved["items"]["board"]["target"] == "target_paper.yaml"
    assert World.load(tmp_path / "world.yaml").items["board"] == World.load("world_paper").items[
        "board"
    ].model_copy(update={"target": "target_paper.yaml"})
