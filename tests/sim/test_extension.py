"""The Blender extension: its archive, what it is told of a rig, and its operators at work in Blender."""

import importlib.util
import io
import json
import os
import subprocess
import sys
import tomllib
import zipfile
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import igl
import numpy as np
import pytest

from fpplab.artefacts import make
from fpplab.core import config
from fpplab.core.errors import ConfigError
from fpplab.core.plugins import COMMANDS, plugin_names
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from fpplab.pipeline.taking import take_poses
from fpplab.sessions.session import Session
from sim.build import SceneState
from sim.extension import MANIFEST, write_extension
from sim.items import item_poses
from sim.light import ShownPattern
from sim.preview import Arrangement, baseline_range_mm, bench_of_rig, make_preview, stage_for_baseline
from sim.preview_file import read_preview, write_preview
from sim.sensor import SensorModel
from tests.sim.conftest import RIG, plain, world, write_world

ROOT = Path(__file__).parents[2]
RIG_WITH_STAGE = RIG.replace("bits: 12", "bits: 8") + 'stage: {backend: "sim.devices:SimStage"}\n'
ENTRY_POINT = "[fpplab.commands]\ntwin = sim.commands.twin:twin\n"

Picture = np.ndarray[Any, Any]


@pytest.fixture(scope="module")
def python_path(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Where child processes find this checkout, and its commands if it was installed before it had them."""
    known = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    if "twin" in plugin_names(COMMANDS):
        return known
    folder = tmp_path_factory.mktemp("metadata")
    metadata = folder / "fpplab_twin-0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: fpplab-twin\nVersion: 0\n")
    (metadata / "entry_points.txt").write_text(ENTRY_POINT)
    return f"{known}{os.pathsep}{folder}"


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("extension") / "fpplab.zip"
    with path.open("wb") as stream:
        write_extension(stream)
    return path


@pytest.fixture(scope="module")
def small_rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rig")
    write_world(folder, plain(ambient=0.05, mounted="pillars"))
    (folder / "rig.yaml").write_text(RIG_WITH_STAGE)
    return folder / "rig.yaml"


def twin_command(python_path: str, *words: object) -> subprocess.CompletedProcess[str]:
    """`fpplab twin WORDS`."""
    return subprocess.run(
        [sys.executable, "-P", "-m", "fpplab", "twin", *map(str, words), "--json"],
        env={**os.environ, "PYTHONPATH": python_path},
        capture_output=True,
        text=True,
        check=False,
    )


def seen_by_twin(rig: Rig, wanted: Arrangement, step: int) -> Picture:
    """Mean grey levels by the twin's own light path, from its tables of direct light."""
    bench, plan, caps = bench_of_rig(rig), wanted.fringes(), rig.projector.caps
    patterns = tuple(rig.projector.load(make_patterns(plan, caps.size, caps.lattice)))
    stage_mm = stage_for_baseline(bench.world, wanted.baseline_mm)
    setup = SceneState(wanted.item or bench.world.mounted, wanted.pose, stage_mm)
    irradiance = bench.light.irradiance(setup, ShownPattern(patterns, step))
    return SensorModel.of(bench.world).expected(irradiance, rig.camera_settings(plan.exposure_s))


# The archive


def test_archive_is_the_same_every_time(archive: Path) -> None:
    again = io.BytesIO()
    write_extension(again)
    assert again.getvalue() == archive.read_bytes()


def test_manifest_agrees_with_the_project(archive: Path) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    with zipfile.ZipFile(archive) as files:
        manifest = tomllib.loads(files.read(MANIFEST).decode())
    assert manifest["version"] == project["version"]
    assert manifest["license"] == [f"SPDX:{project['license']}"]
    assert manifest["maintainer"] == project["authors"][0]["name"]
    assert manifest["blender_version_min"] == "4.5.0"


def test_blender_finds_the_archive_valid(archive: Path) -> None:
    """By its own tool, tags included."""
    spec = importlib.util.find_spec("bpy")
    assert spec is not None
    assert spec.origin is not None
    (scripts,) = Path(spec.origin).parent.glob("[0-9]*/scripts")
    tool = scripts / "addons_core/bl_pkg/cli/blender_ext.py"
    tags = scripts / "modules/_bpy_internal/extensions/tags.py"
    done = subprocess.run(
        [sys.executable, str(tool), "validate", "--valid-tags", str(tags), str(archive)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_archive_needs_nothing_that_blender_lacks(archive: Path) -> None:
    """Its modules import each other by relative names, the standard library, NumPy, and Blender's own."""
    allowed = {*sys.stdlib_module_names, "numpy", "bpy", "mathutils", "_cycles"}
    with zipfile.ZipFile(archive) as files:
        sources = {name: files.read(name).decode() for name in files.namelist() if name.endswith(".py")}
        names = set(files.namelist())
    for name, source in sources.items():
        for module, level in imports(source):
            if level:
                folder = Path(name).parents[level - 1]
                place = folder.joinpath(*module.split(".")).as_posix()
                assert {f"{place}.py", f"{place}/__init__.py"} & names, f"{name} imports {place}"
            else:
                assert module.partition(".")[0] in allowed, f"{name} imports {module}"


def imports(source: str) -> list[tuple[str, int]]:
    """Modules that are imported at run time, with the dots before their names."""
    import ast

    tree, found = ast.parse(source), []
    checked = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(alias.name, 0) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and id(node) not in checked:
            found.append((node.module or "", node.level)) if node.module else found.extend(
                (alias.name, node.level) for alias in node.names
            )
    return found


# What the extension is told


def test_preview_is_read_as_it_was_written(small_rig: Path, tmp_path: Path) -> None:
    with Rig.load(small_rig) as rig:
        preview = make_preview(rig, Arrangement(item="board", stripes=20, steps=4), 1)
    path = tmp_path / "preview.npz"
    with path.open("wb") as stream:
        write_preview(preview, stream)
    same(preview, read_preview(path))


def same(one: Any, other: Any) -> None:
    if is_dataclass(one):
        assert type(one) is type(other)
        for field in fields(one):
            same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for left, right in zip(one, other, strict=True):
            same(left, right)
    else:
        np.testing.assert_array_equal(one, other)


def test_another_file_is_no_preview(tmp_path: Path) -> None:
    np.savez(tmp_path / "other.npz", points=np.zeros(3))
    with pytest.raises(ValueError, match="describes no rig"):
        read_preview(tmp_path / "other.npz")


def test_stage_is_where_the_baseline_is_as_asked() -> None:
    of = world(stage={"travel_mm": [-60, 80], "axis": [1.0, 0.2, 0.1]})
    low, high = baseline_range_mm(of)
    for wanted in (low + 0.01, 140.0, 165.5, high - 0.01):
        place = of.T_projector_camera(stage_for_baseline(of, wanted)).inverse().translation
        assert np.linalg.norm(place) == pytest.approx(wanted)
    assert stage_for_baseline(of, 150.0) == pytest.approx(0.0, abs=1e-5)
    for wanted in (low - 0.1, high + 0.1, 1.0):
        with pytest.raises(ConfigError, match=rf"baseline {wanted:g} mm: the stage reaches {low:.1f} to"):
            stage_for_baseline(of, wanted)


@pytest.mark.parametrize(
    ("wanted", "step", "said"),
    [
        (Arrangement(item="cube"), 0, "no item 'cube'; there are card, pillars, board"),
        (Arrangement(item="board", pose=4), 0, "pose 4: 'board' has the poses 0 to 3"),
        (Arrangement(steps=4), 4, "step 4: must be 0 to 3, for there are 4 steps"),
        (Arrangement(stripes=600), 0, "600"),
    ],
)
def test_wrong_arrangements_are_refused(small_rig: Path, wanted: Arrangement, step: int, said: str) -> None:
    with Rig.load(small_rig) as rig, pytest.raises(ConfigError, match=said):
        make_preview(rig, wanted, step)


def test_scan_has_coarser_fringes_in_equal_ratios() -> None:
    counts = [fringe.stripes for fringe in Arrangement(stripes=64).plan().fringes]
    assert counts == pytest.approx([1, 8, 64])
    counts = [fringe.stripes for fringe in Arrangement(stripes=100).plan().fringes]
    assert counts == pytest.approx([1, 100 ** (1 / 3), 100 ** (2 / 3), 100])
    assert [fringe.stripes for fringe in Arrangement(stripes=5).plan().fringes] == [1, 5]


@pytest.mark.whole
def test_rigs_that_are_not_simulated_are_refused(python_path: str, tmp_path: Path) -> None:
    done = twin_command(python_path, "export", "--rig", "rig_emulated", "--out", tmp_path / "r.blend")
    assert done.returncode == 2
    assert "is not simulated, so there is no scene to show" in json.loads(done.stdout)["error"]
    assert list(tmp_path.iterdir()) == []


# The process that the extension starts


@pytest.fixture(scope="module")
def jobs() -> ModuleType:
    """The module of the extension that needs no Blender."""
    spec = importlib.util.spec_from_file_location("jobs", ROOT / "sim/blender/extension/jobs.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["jobs"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.whole
def test_failed_command_says_why_and_leaves_no_files(
    jobs: ModuleType, python_path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", python_path)
    job = jobs.Job(sys.executable, ["twin", "export", "--rig", "no_such_rig", "--out", "{folder}/r.blend"])
    job.wait()
    with pytest.raises(jobs.JobFailedError, match="no_such_rig"):
        job.answer()
    job.close()
    assert not job.folder.exists()


def test_running_commands_end_with_the_extension(jobs: ModuleType, tmp_path: Path) -> None:
    """A program that only waits stands for a long command."""
    waiting = tmp_path / "python"
    waiting.write_text("#!/bin/sh\nexec sleep 600\n")
    waiting.chmod(0o700)
    job = jobs.Job(str(waiting), ["twin"])
    assert not job.is_done()
    jobs.end_all()
    assert job.is_done()
    assert not job.folder.exists()


# The operators at work


def operate(folder: Path, archive: Path, rig: Path, python_path: str, *parts: str) -> dict[str, Any]:
    """Run operate_extension.py in Blender with its own settings and its own temporary folder."""
    (folder / "tmp").mkdir()
    environment = {
        "BLENDER_USER_RESOURCES": str(folder / "blender"),
        "TMPDIR": str(folder / "tmp"),
        "PYTHONPATH": python_path,
    }
    script = Path(__file__).with_name("operate_extension.py")
    done = subprocess.run(
        [sys.executable, "-P", str(script), str(archive), sys.executable, str(folder), str(rig), *parts],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    told: dict[str, Any] = json.loads((folder / "told.json").read_text())
    return told


@pytest.mark.nightly
def test_pictures_of_the_demonstration_are_the_twins(
    tmp_path: Path, archive: Path, small_rig: Path, python_path: str
) -> None:
    told = operate(tmp_path, archive, small_rig, python_path, "demonstration")
    assert told["enabled"]
    assert "no Python with fpplab is named" in told["without interpreter"]
    assert "/no/such/python cannot be started" in told["wrong interpreter"]
    assert "there is no item 'cube'" in told["wrong item"]
    assert not told["picture before"]
    assert told["objects"] == ["camera", "item", "projector"]
    assert told["added"]["scenes"] == ["fpplab"]
    assert told["differs"] == {}
    shown = {"first": (Arrangement(stripes=20, steps=4), 1)}
    shown["second"] = (Arrangement(stripes=20, steps=4, baseline_mm=165), 2)
    with Rig.load("rig_demo_quick") as rig:
        for name, (wanted, step) in shown.items():
            picture = cv2.imread(str(tmp_path / f"{name}.png"), cv2.IMREAD_UNCHANGED)
            twins = seen_by_twin(rig, wanted, step)
            assert twins.max() > 150
            assert np.abs(picture[..., 0] - twins).max() <= 1


@pytest.mark.nightly
def test_scan_and_its_errors_come_back_into_the_scene(
    tmp_path: Path, archive: Path, small_rig: Path, python_path: str
) -> None:
    make("pillars", {}).export(tmp_path / "pillars.stl")
    told = operate(tmp_path, archive, small_rig, python_path, "measurement")
    assert "name a folder for the session" in told["no session"]
    assert told["differs"] == {}
    assert Session.open(tmp_path / "session").missing() == []
    found = np.load(tmp_path / "cloud.npz")
    np.testing.assert_allclose(found["matrix"], np.eye(4), atol=1e-6)
    assert len(found["points"]) > 1000
    with Rig.load(small_rig) as rig:
        of = bench_of_rig(rig).world
        shape = make("pillars", {})
        moved = item_poses(of, "pillars")[0].apply(shape.vertices)
        points = np.ascontiguousarray(found["points"][::20], np.float64)
        square = igl.point_mesh_squared_distance(points, moved, np.asarray(shape.faces, np.int64))[0]
        assert np.sqrt(np.median(square)) < 0.2
        twins = seen_by_twin(rig, Arrangement(item="pillars", stripes=32, steps=4), 0)
    assert np.ptp(found["colours"][:, :3], axis=0).min() > 0.3
    assert np.abs(255 * np.load(tmp_path / "third.npy") - twins).max() <= 1  # the cloud is not in it


@pytest.mark.nightly
def test_twin_is_fitted_and_shown(tmp_path: Path, archive: Path, small_rig: Path, python_path: str) -> None:
    data = config.parse_yaml(config.find_config("rig_twin").read_text(), "rig_twin")
    data["bench"] |= {"binning": 8, "analytic": True, "world": "world_twin.yaml"}
    (tmp_path / "nominal.yaml").write_text(config.to_yaml(data))
    (tmp_path / "bench.yaml").write_text(
        config.to_yaml({**data, "bench": {**data["bench"], "world": "world_hidden.yaml"}})
    )
    sets = [Sinusoid(axis=axis, stripes=n, steps=4) for axis in ("x", "y") for n in (1, 8, 48)]
    with Rig.load(tmp_path / "bench.yaml") as rig:
        take_poses(rig, Plan(fringes=tuple(sets)), "board", 4, tmp_path / "board", replace_existing=False)
    told = operate(tmp_path, archive, small_rig, python_path, "matching")
    assert Path(told["matched"]) == tmp_path / "matched" / "rig.yaml"
    assert told["differs"] == {}


@pytest.mark.whole
def test_exported_scene_stands_alone(tmp_path: Path, small_rig: Path, python_path: str) -> None:
    """Opened without the extension it renders the twin's picture."""
    chosen = ("--rig", small_rig, "--item", "board", "--stripes", 20, "--steps", 4, "--step", 1)
    for command, name in (("export", "rig.blend"), ("describe", "rig.npz")):
        done = twin_command(python_path, command, *chosen, "--out", tmp_path / name)
        assert done.returncode == 0, done.stderr
    program = (
        "import sys, bpy, numpy; from sim.blender.preview import take_picture; "
        "from sim.preview_file import read_preview; folder = sys.argv[1]; "
        "bpy.ops.wm.open_mainfile(filepath=folder + '/rig.blend'); "
        "picture = take_picture(bpy.context.scene, read_preview(folder + '/rig.npz')); "
        "numpy.save(folder + '/picture.npy', picture)"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", program, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": python_path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    with Rig.load(small_rig) as rig:
        twins = seen_by_twin(rig, Arrangement(item="board", stripes=20, steps=4), 1)
    assert np.ptp(twins) > 50
    assert np.abs(np.load(tmp_path / "picture.npy") - twins).max() <= 1
