"""Data sets: labels against the ground truth, resumption after interruption, and the loader."""

import os
import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import binary_erosion

from fpplab import artefacts
from fpplab.acquisition.acquire import expose
from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.conventions import TWO_PI
from fpplab.core.errors import ConfigError, DataError, DeviceError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from fpplab.pipeline.true_maps import trace_true_maps
from fpplab.reconstruction.points import triangulate
from fpplab.targets import Target
from sim.dataset import Dataset
from sim.dataset.card import prepare_folder
from sim.dataset.making import DatasetMaker, DatasetRequest, need_simulation
from sim.dataset.scenes import SceneRanges, draw_scene
from sim.dataset.shard import claim_shard, shard_name
from tests.sessions.test_disk import FullAt
from tests.sim.conftest import RIG, plain, world, write_world
from tests.sim.raycaster import Box, Caster

RIG_OF_BOARDS = (
    RIG.replace("world: world.yaml", "world: world.yaml, analytic: true")
    + 'stage: {backend: "sim.devices:SimStage"}\n'
)
PLAN = Plan(
    fringes=tuple(
        Sinusoid(axis=axis, stripes=stripes, steps=4) for axis in ("x", "y") for stripes in (0.95, 6, 30)
    )
)
ALL = SceneRanges.load("dataset_demo.yaml")
BOARDS = ALL.model_copy(
    update={"artefacts": (), "reflectance": (0.6, 0.65), "ink": (0.58, 0.59), "charge": (0.1, 0.3)}
)
"""Images of boards are computed without Blender. Pixels are as large as the printed features, so
contrast is low and noise high, for the print to shift the phase by less than the noise does."""


@contextmanager
def opened(
    folder: Path, scenes: SceneRanges = BOARDS, samples: int = 5, plan: Plan = PLAN, **options: Any
) -> Iterator[DatasetMaker]:
    """Make small samples, two to a shard."""
    write_world(folder, plain(render={"subpixels": 3}))
    (folder / "rig.yaml").write_text(RIG_OF_BOARDS)
    with Rig.load(folder / "rig.yaml") as rig:
        wanted = DatasetRequest(plan, scenes, samples, **{"seed": 3, "shard_size": 2, **options})
        yield DatasetMaker(rig, wanted)


@pytest.fixture(scope="module")
def boards(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """Five samples of boards, made without interruption."""
    folder = tmp_path_factory.mktemp("boards")
    with opened(folder) as maker:
        maker.make(folder / "set")
    return Dataset(folder / "set")


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def copied(boards: Dataset, out: Path) -> None:
    for name, data in contents(boards.folder).items():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(data)


def devices_of(sample: dict[str, np.ndarray[Any, Any]]) -> Calibration:
    height, width = sample["depth"].shape
    pose = sample["T_projector_camera"]
    return Calibration(
        Pinhole((width, height), sample["camera_matrix"], sample["camera_distortion"]),
        Pinhole((912, 1140), sample["projector_matrix"], sample["projector_distortion"]),
        RigidTransform(pose[:3, :3], pose[:3, 3]),
        {},
    )


def check_sample(sample: dict[str, np.ndarray[Any, Any]], edges_px: int) -> None:
    """Labels and measurement of one sample agree within the noise that the decoding states."""
    mask = sample["mask"]
    np.testing.assert_array_equal(np.isfinite(sample["projector_u"]), mask)
    assert not (mask & np.isnan(sample["depth"])).any()
    seen = np.isfinite(sample["depth"])
    np.testing.assert_allclose((sample["normals"][:, seen] ** 2).sum(axis=0), 1.0, atol=1e-6)
    devices = devices_of(sample)
    height, width = mask.shape
    v, u = np.mgrid[0:height, 0:width]
    slopes = devices.camera.normalise(np.stack([u, v], axis=-1).astype(float))
    rays = np.concatenate([slopes, np.ones((height, width, 1))], axis=-1)
    assert (np.einsum("xhw,hwx->hw", sample["normals"], rays)[seen] < 0).all()
    for n, fringe in enumerate(PLAN.fringes):
        along, length = ("projector_u", 912) if fringe.axis == "x" else ("projector_v", 1140)
        expected = TWO_PI * fringe.stripes * (sample[along].astype(float) + 0.5) / length
        np.testing.assert_allclose(sample["absolute_phase"][n], expected, atol=1e-4)
    good = binary_erosion(mask, iterations=edges_px) & np.isfinite(sample["decoded_sigma"])
    assert good.sum() > 500
    sigma = sample["decoded_sigma"][good]
    check_noise((sample["decoded_u"] - sample["projector_u"])[good] / sigma)
    # Phase noise of the finest set is its coordinate's in rad; all sets along x have as many steps.
    finest = TWO_PI * 30 / 912 * sigma
    for n in range(3):
        turned = (sample["wrapped_phase"] - sample["absolute_phase"])[n][good]
        check_noise(((turned + np.pi) % TWO_PI - np.pi) / finest)
    nothing = np.full_like(sample["depth"], np.nan)
    maps = SimpleNamespace(
        u=sample["decoded_u"], v=nothing, sigma=sample["decoded_sigma"], v_per_u=1.0, sigma_phase_error=None
    )
    cloud = triangulate(maps, devices, normals=False)
    column, row = cloud.pixels.T
    here = good[row, column]
    assert cloud.sigma_noise_mm is not None
    check_noise(((cloud.points[:, 2] - sample["depth"][row, column]) / cloud.sigma_noise_mm)[here])


def check_noise(deviations: np.ndarray[Any, Any]) -> None:
    """Check the spread roughly, since decoding estimates it from four steps, and the median sharply.

    Deviations are in the standard deviations that decoding states; the median is checked in every part of the
    image.
    """
    assert 0.6 < 1.4826 * np.median(np.abs(deviations)) < 1.7
    for part in np.array_split(deviations, 4):
        assert abs(np.median(part)) < 6 * 1.2533 / np.sqrt(len(part)) + 0.02


@pytest.mark.whole
def test_codes_of_other_kinds_are_labelled_too(tmp_path: Path) -> None:
    codes: list[dict[str, Any]] = [
        {"kind": "even", "levels": [1, 0]},
        {"kind": "gray", "axis": "x", "bits": 7, "cell_px": 8},
    ]
    fringes = {"axis": "x", "stripes": 57, "steps": 4}
    for sets, names in (([*codes, fringes], 1), ([{**codes[1], "bits": 9, "cell_px": 2}, codes[0]], 0)):
        plan = config.validate({"fringes": sets}, Plan, "plan")
        with opened(tmp_path, samples=1, plan=plan) as maker:
            sample, _ = maker.sample(0)
        good = binary_erosion(sample["mask"], iterations=8) & np.isfinite(sample["decoded_sigma"])
        assert good.sum() > 500
        check_noise(((sample["decoded_u"] - sample["projector_u"]) / sample["decoded_sigma"])[good])
        assert len(sample.get("absolute_phase", [])) == names


@pytest.mark.whole
def test_several_exposures_are_merged_for_what_is_measured(tmp_path: Path) -> None:
    plan = PLAN.model_copy(update={"exposures_s": (0.04, 0.01), "exposure_s": 0.02})
    with opened(tmp_path, samples=1, plan=plan) as maker:
        sample, record = maker.sample(0)
    frames = sample["frames"].astype(float)
    assert len(frames) == 2 * PLAN.images
    assert sample["exposure_s"] == record["scene"]["exposure_s"]
    assert frames[: PLAN.images].mean() > 1.5 * frames[PLAN.images :].mean()
    check_sample(sample, 8)


def test_labels_are_those_of_an_independent_ray_caster() -> None:
    """A box on a plate, with shadows, through two distorted lenses; away from edges every pixel."""
    of = world()
    pose = RigidTransform.from_vectors(np.array([np.pi - 0.1, 0.15, 0.2]), np.array([3.0, -2.0, 460.0]))
    corners = [((-60, -45, -5), (60, 45, 0)), ((-20, -15, 0), (15, 20, 25))]
    boxes = [Box(np.array(low, float), np.array(high, float), pose) for low, high in corners]
    meshes = [trimesh.creation.box(bounds=np.array(bounds, float)) for bounds in corners]
    mesh = trimesh.util.concatenate(meshes).apply_transform(pose.matrix)
    devices = Calibration(of.camera_model(), of.projector_model(), of.T_projector_camera(), {})
    labels = trace_true_maps(mesh, devices)
    caster = Caster(devices.camera, devices.projector, devices.T_projector_camera, 475.0, 1.0)
    seen = caster.look(boxes, 1)
    wide, high = devices.projector.size
    inside = (seen.u[0] > -0.5) & (seen.u[0] < wide - 0.5) & (seen.v[0] > -0.5) & (seen.v[0] < high - 0.5)
    here = seen.smooth & inside
    hit = (seen.kind[0] > 0) & (seen.shade[0] == 0)
    assert here.sum() > 5000
    assert labels.mask[here].all()
    assert (~labels.mask[hit]).mean() > 0.9, "edges of shadows differ by a pixel"
    assert hit.sum() > 200, "there is a shadow"
    np.testing.assert_allclose(labels.depth[here], seen.points[0][here][:, 2], atol=1e-4)
    np.testing.assert_allclose(labels.u[here], seen.u[0][here], atol=1e-3)
    np.testing.assert_allclose(labels.v[here], seen.v[0][here], atol=1e-3)
    outward = np.round(np.einsum("xn,xy->ny", labels.normals[:, here], pose.rotation), 5)
    assert {tuple(np.abs(n)) for n in outward} <= {(1, 0, 0), (0, 1, 0), (0, 0, 1)}
    assert (outward[np.abs(outward[:, 2]) == 1, 2] == 1).all(), "tops look up"


def test_plate_lit_from_behind_is_visible_but_masked() -> None:
    """Camera and projector on opposite sides of a flat sheet: it is visible, but not illuminated."""
    plate = trimesh.Trimesh(
        [[-30, -30, 450], [30, -30, 450], [30, 30, 450], [-30, 30, 450]],
        [[0, 1, 2], [0, 2, 3]],
        process=False,
    )
    camera = Pinhole.from_focal((64, 48), (400.0, 400.0), (31.5, 23.5))
    behind = RigidTransform.from_vectors(np.array([0.0, np.pi, 0.0]), np.array([0.0, 0.0, 900.0]))
    labels = trace_true_maps(plate, Calibration(camera, camera, behind, {}))
    assert np.isfinite(labels.depth).sum() > 1000
    assert not labels.mask.any()
    assert (labels.normals[2][np.isfinite(labels.depth)] == -1).all()
    beside = RigidTransform.from_vectors(np.zeros(3), np.array([-1.0, 0.0, 0.0]))
    assert trace_true_maps(plate, Calibration(camera, camera, beside, {})).mask.sum() > 1000


@pytest.mark.whole
def test_boards_agree_with_their_labels(boards: Dataset) -> None:
    for k in range(3):
        check_sample(boards[k], edges_px=2)


@pytest.mark.whole
def test_artefacts_agree_with_their_labels_in_any_order(tmp_path: Path) -> None:
    """Rendered by Blender; each sample is the same by itself as after others."""
    scenes = ALL.model_copy(update={"targets": (), "gloss": (0.0, 0.0)})
    with opened(tmp_path, scenes) as maker:
        first, record = maker.sample(0)
        maker.sample(1)
        again, same = maker.sample(0)
    assert record == same
    for name in first:
        np.testing.assert_array_equal(first[name], again[name], err_msg=name)
    check_sample(first, edges_px=3)
    sizes = record["scene"]["sizes"]
    usual = artefacts.usual_sizes(record["scene"]["artefact"])
    for name, length in usual.items():
        share = np.asarray(sizes[name]) / np.asarray(length)
        assert (np.abs(share - 1) <= scenes.variation).all()
        assert (share != 1).all()


NOMINAL = world(camera={**plain()["camera"], "distortion": [0.0] * 5})
DEVICES = Calibration(
    NOMINAL.camera_model(), NOMINAL.projector_model(), NOMINAL.T_projector_camera(), rms_px={}
)


@pytest.mark.whole
@given(seed=st.integers(0, 2**40), index=st.integers(0, 10**6))
def test_scenes_are_drawn_within_their_ranges(seed: int, index: int) -> None:
    scene = draw_scene(ALL, seed, index, DEVICES, 0.0)
    assert scene == draw_scene(ALL, seed, index, DEVICES, 0.0)
    assert scene != draw_scene(ALL, seed, index + 1, DEVICES, 0.0)
    for name, drawn in scene.model_dump().items():
        if isinstance(ends := getattr(ALL, name, None), tuple) and isinstance(drawn, float):
            assert ends[0] <= drawn <= ends[1], name
    pose = scene.pose.transform()
    assert ALL.distance_mm[0] <= pose.translation[2] <= ALL.distance_mm[1]
    if scene.artefact is not None:
        bounds = np.asarray(artefacts.make(scene.artefact, scene.sizes).bounds)
        up = -pose.rotation[2, 2]
    else:
        assert scene.target is not None
        half = 0.5 * np.array([*Target.load(scene.target).size_mm, 0])
        bounds, up = np.stack([-half, half]), pose.rotation[2, 2]
    assert up >= np.cos(np.radians(ALL.tilt_deg)) - 1e-9
    points = np.stack(np.meshgrid(*[np.linspace(*ends, 3) for ends in bounds.T]), axis=-1).reshape(-1, 3)
    points = pose.apply(points)
    visible = DEVICES.camera.sees(points) & DEVICES.projector.sees(points, DEVICES.T_projector_camera)
    assert visible.mean() >= 0.5


@pytest.mark.whole
def test_draft_of_a_killed_process_is_started_again(boards: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "set"
    copied(boards, out)
    half = out / f".{shard_name(1)}"
    (out / shard_name(1)).rename(half)
    (half / "depth.npy").write_bytes(b"half")
    (half / "from an older version.npy").write_bytes(b"")
    (out / "README.md").unlink()  # as if killed before it was written
    assert Dataset(out).indices == [0, 1, 4], "incomplete shards are not listed"
    seen: list[float] = []
    with opened(tmp_path) as maker:
        maker.make(out, seen.append)
    assert seen == sorted(seen)
    assert seen[-1] == 1.0
    assert contents(out) == contents(boards.folder)


@pytest.mark.whole
def test_two_processes_do_not_make_the_same_shard(tmp_path: Path, boards: Dataset) -> None:
    out = tmp_path / "set"
    with opened(tmp_path) as maker:
        prepare_folder(out, maker.card())
        with claim_shard(out, 1) as draft:
            assert draft is not None
            with claim_shard(out, 1) as again:
                assert again is None
            maker.make(out)
            assert Dataset(out).indices == [0, 1, 4]
        with claim_shard(out, 1) as done:
            assert done is None
        (out / shard_name(1)).rmdir()  # empty: that draft was never filled
        maker.make(out)
    assert contents(out) == contents(boards.folder)


def test_failed_shard_leaves_no_draft(tmp_path: Path) -> None:
    def fail() -> None:
        with claim_shard(tmp_path, 0) as draft:
            assert draft is not None
            (draft / "half").write_bytes(b"half")
            raise DeviceError("camera", "snap", "unplugged")

    with pytest.raises(DeviceError):
        fail()
    assert not list(tmp_path.iterdir())


def test_the_loader_indexes_as_a_list(boards: Dataset) -> None:
    assert len(boards) == 5
    assert len(list(boards)) == 5  # type: ignore[call-overload]
    first, last = boards[0], boards[np.int64(-1)]  # type: ignore[index]
    fields = {field["name"]: field for field in boards.card["fields"]}
    assert list(first) == list(fields)
    for name, array in first.items():
        assert (array.dtype, list(array.shape)) == (np.dtype(fields[name]["dtype"]), fields[name]["shape"])
        array[...] = 0  # its own
    assert boards[0]["frames"].any()
    for index in (5, -6):
        with pytest.raises(IndexError):
            boards[index]
    assert boards.scene(-1)["index"] == 4
    assert boards.scene(4)["world"]["seed"] == boards.scene(4)["scene"]["seed"]
    mapped = np.load(boards.folder / shard_name(2) / "depth.npy", mmap_mode="r")
    np.testing.assert_array_equal(mapped[0], last["depth"])
    assert boards.plan == PLAN
    assert boards.card["bytes_per_sample"] == sum(array.nbytes for array in first.values())
    boards.check()


def test_loader_can_be_pickled(boards: Dataset) -> None:
    chosen = Dataset(boards.folder, ["depth", "mask"])
    sent = pickle.loads(pickle.dumps(chosen))
    assert list(sent[1]) == ["depth", "mask"]
    np.testing.assert_array_equal(sent[1]["depth"], boards[1]["depth"])
    open_files = len(os.listdir("/proc/self/fd"))
    kept = [chosen[k] for k in range(5)]
    assert len(os.listdir("/proc/self/fd")) == open_files
    assert len(kept) == 5


def test_splits_share_no_scene(boards: Dataset) -> None:
    parts = {name: boards.split(name) for name in ("train", "validation", "test")}
    assert {name: len(part) for name, part in parts.items()} == boards.card["splits"]
    assert sorted(k for part in parts.values() for k in part.indices) == boards.indices
    assert [parts["validation"].scene(0)["index"], parts["validation"].scene(0)["split"]] == [4, "validation"]
    with pytest.raises(ConfigError, match="no split 'dev'; it has train, validation, test"):
        boards.split("dev")


def test_recorded_world_reproduces_the_recorded_frames(boards: Dataset, tmp_path: Path) -> None:
    """Rendering the recorded world again gives the recorded frames."""
    record, recorded = boards.scene(2), boards[2]
    (tmp_path / "world.yaml").write_text(config.to_yaml(record["world"]))
    (tmp_path / "rig.yaml").write_text(RIG_OF_BOARDS)
    with Rig.load(tmp_path / "rig.yaml") as rig:
        assert rig.stage is not None
        rig.stage.home()
        rig.stage.move_to(record["scene"]["stage_mm"])
        caps = rig.projector.caps
        patterns = make_patterns(PLAN, caps.size, caps.lattice)
        shots = expose(rig, patterns, rig.camera_settings(float(recorded["exposure_s"])))
        np.testing.assert_array_equal([shot.image for shot in shots], recorded["frames"])


def test_damage_is_found_and_named(boards: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "set"
    copied(boards, out)
    path = out / shard_name(1) / "normals.npy"
    data = bytearray(path.read_bytes())
    data[-5] ^= 1
    path.write_bytes(data)
    with pytest.raises(
        DataError, match=r"shard_00001/normals\.npy: is damaged, .* remove .*shard_00001 and run"
    ):
        Dataset(out).check()
    with opened(tmp_path) as maker, pytest.raises(DataError, match=r"normals\.npy: is damaged"):
        maker.make(out)
    path.unlink()
    with pytest.raises(DataError, match="is not a complete shard"):
        Dataset(out).check()
    with pytest.raises(DataError, match=r"normals\.npy: is missing or damaged"):
        Dataset(out)[2]
    (out / "card.json").write_text("{")
    with pytest.raises(DataError, match=r"card\.json: cannot be read"):
        Dataset(out)
    with pytest.raises(DataError, match="is not a data set"):
        Dataset(tmp_path)
    with pytest.raises(ConfigError, match=r"has no field 'dept'; it has frames, .*, depth,"):
        Dataset(boards.folder, ["dept"])


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"seed": 4}, r"another 'seed' \(3, now 4\)"),
        ({"samples": 6}, r"another 'samples' \(5, now 6\)"),
        ({"shard_size": 3}, r"another 'shard_size' \(2, now 3\)"),
        ({"scenes": BOARDS.model_copy(update={"tilt_deg": 20.0})}, "another 'scenes'; name another output"),
    ],
)
def test_folder_with_another_card_is_refused(
    boards: Dataset, tmp_path: Path, change: dict[str, Any], named: str
) -> None:
    copied(boards, tmp_path / "set")
    with opened(tmp_path, **change) as maker, pytest.raises(ConfigError, match=named):
        maker.make(tmp_path / "set")
    assert contents(tmp_path / "set") == contents(boards.folder)


def test_folder_without_a_data_set_is_left_unchanged(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "thesis.tex").write_text("years of work")
    with opened(tmp_path) as maker, pytest.raises(ConfigError, match="exists and is not a data set"):
        maker.make(tmp_path / "set")
    assert [p.name for p in (tmp_path / "set").iterdir()] == ["thesis.tex"]


@pytest.mark.nightly
def test_full_disk_is_reported_and_leaves_no_incomplete_shard(
    tmp_path: Path, boards: Dataset, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "set"
    with opened(tmp_path) as maker:
        prepare_folder(out, maker.card())
        for n in (1, 5):
            with monkeypatch.context() as patch:
                patch.setattr(os, "fsync", FullAt(n, os.fsync))
                with pytest.raises(DataError, match="shard_00000: no space left on the disk; free some and"):
                    maker.make(out)
            assert sorted(p.name for p in out.iterdir()) == ["README.md", "card.json", "plan.yaml"]
        maker.make(out)
    assert contents(out) == contents(boards.folder)


def test_ranges_beyond_the_rig_are_refused_before_the_first_scene(tmp_path: Path) -> None:
    for update, named in (
        ({"stage_mm": (-80.0, 0.0)}, r"'stage_mm' is \[-80, 0\]: outside the stage's travel, -60 to 60"),
        ({"exposure_s": (0.01, 20.0)}, r"'exposure_s' is \[0.01, 20\]: outside the camera's exposure"),
    ):
        with pytest.raises(ConfigError, match=named), opened(tmp_path, BOARDS.model_copy(update=update)):
            pass


@pytest.mark.parametrize("name", ["rig_bench", "rig_emulated_quick"])
def test_a_rig_that_is_no_simulation_is_refused_before_it_opens(name: str) -> None:
    with pytest.raises(ConfigError, match=f"{name}: its bench is no simulation"):
        need_simulation(Rig.load(name), name)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (
            {"reflectance": [0.9, 0.3]},
            "'reflectance' is .*must be the minimum and the maximum, within 0 to 1",
        ),
        ({"artefacts": [], "targets": []}, "both empty"),
        ({"artefacts": ["cube"]}, "there is no artefact 'cube'"),
        ({"targets": ["nowhere.yaml"]}, "nowhere.yaml: there is no such file"),
        ({"ink": [0.03, 0.4]}, "'ink' reaches 0.4"),
        ({"tilt": 3}, "unknown key 'tilt'"),
    ],
)
def test_wrong_ranges_are_refused(tmp_path: Path, change: dict[str, Any], named: str) -> None:
    data = {**config.parse_yaml(config.read_text(config.find_config("dataset_demo.yaml")), ""), **change}
    (tmp_path / "ranges.yaml").write_text(config.to_yaml(data))
    with pytest.raises(ConfigError, match=named):
        SceneRanges.load(tmp_path / "ranges.yaml")


def test_ranges_that_leave_no_pose_are_refused() -> None:
    with pytest.raises(ConfigError, match="hardly any item lies there in the camera's image and"):
        draw_scene(ALL.model_copy(update={"distance_mm": (20.0, 25.0)}), 0, 0, DEVICES, 0.0)
