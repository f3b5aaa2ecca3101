"""The wheel: what lands in site-packages, under which names, and that it runs with nothing else there."""

import base64
import csv
import hashlib
import json
import os
import resource
import subprocess
import sys
import tomllib
import venv
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import hatch_build
from tests.support.commands import ROOT

WORDS = {"drivers": "fpplab_drivers", "sim": "fpplab_sim"}
LARGEST_MB = 860
"""What an environment with the core may take. docs/decisions lists the largest parts."""
LONGEST_S = 500
CONSTRAINTS = ROOT / f"constraints-{sys.version_info.major}.{sys.version_info.minor}.txt"


SOURCE = b"""from __future__ import annotations
from sim.scene import X
from drivers import apart
    # from sim.x
from simulated import Y
"""
MOVED = b"""from __future__ import annotations
from fpplab_sim.scene import X
from fpplab_drivers import apart
    # from sim.x
from simulated import Y
"""
ENTRIES = b"[fpplab.commands]\ntwin = sim.commands:twin\n\n[x]\nown = fpplab.a:B\nold = drivers:C\n"
NEW = b"[fpplab.commands]\ntwin = fpplab_sim.commands:twin\n\n[x]\nown = fpplab.a:B\nold = fpplab_drivers:C\n"


def test_imports_and_entry_points_are_renamed() -> None:
    assert hatch_build.renamed_content("fpplab_sim/a.py", SOURCE) == MOVED
    assert hatch_build.renamed_content("fpplab-0.dist-info/entry_points.txt", ENTRIES) == NEW
    assert hatch_build.renamed_content("fpplab_sim/a.osl", SOURCE) == SOURCE
    with pytest.raises(ValueError, match=r"a.py: imports sim.scene; write 'from sim.scene import"):
        hatch_build.renamed_content("a.py", b"import sim.scene\n")


@pytest.mark.parametrize(
    ("path", "wheel"),
    [("sim/scene.py", "fpplab_sim/scene.py"), ("drivers/py.typed", "fpplab_drivers/py.typed"),
     ("fpplab/devices/simulation.py", "fpplab/devices/simulation.py"), ("simple.py", "simple.py")],
)  # fmt: skip
def test_files_are_moved(path: str, wheel: str) -> None:
    assert hatch_build.renamed_path(path) == wheel


def test_the_record_of_a_renamed_wheel_is_its_files(tmp_path: Path) -> None:
    wheel = tmp_path / "x.whl"
    files = {"sim/a.py": b"from sim import b\n", "fpplab/c.txt": b"c", "x-0.dist-info/RECORD": b"old,,\n"}
    with zipfile.ZipFile(wheel, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    hatch_build.rename_packages(wheel)
    with zipfile.ZipFile(wheel) as archive:
        assert archive.namelist() == ["fpplab_sim/a.py", "fpplab/c.txt", "x-0.dist-info/RECORD"]
        rows = list(csv.reader(archive.read("x-0.dist-info/RECORD").decode().splitlines()))
        assert rows[-1] == ["x-0.dist-info/RECORD", "", ""]
        for name, digest, size in rows[:-1]:
            content = archive.read(name)
            expected = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).decode().rstrip("=")
            assert (digest, int(size)) == (f"sha256={expected}", len(content))
        assert archive.read("fpplab_sim/a.py") == b"from fpplab_sim import b\n"


Run = Callable[..., str]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, float]:
    """An environment with nothing but the core, installed from a wheel; and the seconds that pip computed."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--no-build-isolation", "-w", folder, ROOT]
    quietly = ["--quiet", "--disable-pip-version-check"]
    subprocess.run([*build, *quietly], check=True, cwd=folder, timeout=LONGEST_S)
    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "env", with_pip=True)
    python = folder / "env" / "bin" / "python"
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    install = [python, "-m", "pip", "install", *quietly, "--constraint", CONSTRAINTS, wheel]
    subprocess.run(install, check=True, cwd=folder, env=clean(), timeout=LONGEST_S)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return python, after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime


def clean(**more: str) -> dict[str, str]:
    """The environment without what leads to this checkout."""
    kept = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", "FPPLAB_ALLOW_BACKEND")}
    return {**kept, **more}


@pytest.fixture(scope="module")
def run_installed(installed: tuple[Path, float], tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Run its Python outside of the checkout; gives stdout."""
    folder = tmp_path_factory.mktemp("elsewhere")

    def run(*words: object, code: int = 0) -> str:
        command = [str(installed[0]), *map(str, words)]
        done = subprocess.run(
            command, cwd=folder, env=clean(), capture_output=True, text=True, timeout=LONGEST_S, check=False
        )
        assert done.returncode == code, done.stderr
        return done.stdout

    return run


@pytest.mark.whole
def test_the_core_is_installed_soon_and_small(installed: tuple[Path, float]) -> None:
    python, seconds = installed
    assert seconds < 60.0
    taken = subprocess.run(["du", "-sm", python.parents[1]], capture_output=True, text=True, check=True)
    assert int(taken.stdout.split()[0]) < LARGEST_MB


@pytest.mark.whole
def test_only_names_of_its_own_land_in_site_packages(run_installed: Run) -> None:
    program = (
        "import importlib.metadata as m; print(*sorted({str(f).split('/')[0] for f in m.files('fpplab')}))"
    )
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    names = run_installed("-c", program).split()
    assert names == ["..", "fpplab", f"fpplab-{version}.dist-info", *WORDS.values()]
    for old in WORDS:
        run_installed("-c", f"import {old}", code=1)


EVERY_MODULE = """
import importlib, pkgutil, fpplab, fpplab_drivers, fpplab_sim
from fpplab.core.extras import extra_of
wanted = set()
for package in (fpplab, fpplab_drivers, fpplab_sim):
    for module in pkgutil.walk_packages(package.__path__, package.__name__ + "."):
        if ".__main__" in module.name or module.name.startswith("fpplab_sim.blender."):
            continue
        try:
            importlib.import_module(module.name)
        except ModuleNotFoundError as error:
            assert extra_of(error.name or ""), (module.name, error)
            wanted.add(extra_of(error.name))
        except ImportError as error:
            assert "pip install 'fpplab[" in str(error), (module.name, error)
print(*sorted(wanted))
"""


@pytest.mark.whole
def test_every_module_is_found_by_its_new_name(run_installed: Run) -> None:
    found = run_installed("-W", "ignore", "-c", EVERY_MODULE).split()
    bench, other = (
        {"basler", "lightcrafter", "stage", "display", "gentl"},
        {"twin", "viewer", "optimise", "service"},
    )
    assert {*found} <= bench | other
    assert "basler" in found


HEAVY = (
    "bpy",
    "cv2",
    "matplotlib",
    "numba",
    "numpy",
    "pydantic",
    "rerun",
    "scipy",
    "skimage",
    "trimesh",
    "yaml",
)
LOADED = f"""
import contextlib, io, runpy, sys
sys.argv = ["fpplab", "--help"]
with contextlib.redirect_stdout(io.StringIO()), contextlib.suppress(SystemExit):
    BEGIN
print([name for name in {HEAVY} if name in sys.modules])
"""


@pytest.mark.whole
@pytest.mark.parametrize("begin", ["import fpplab", "runpy.run_module('fpplab', run_name='__main__')"])
def test_what_it_does_not_need_at_once_is_not_loaded(run_installed: Run, begin: str) -> None:
    assert run_installed("-c", LOADED.replace("BEGIN", begin)) == "[]\n"


@pytest.mark.whole
def test_old_names_of_backends_go_on(run_installed: Run) -> None:
    names = ("sim.devices:SimCamera", "virtual_camera", "fpplab_sim.devices:SimCamera")
    for name in names:
        program = f"from fpplab.devices.backends import load_backend as b; print(b({name!r}, 'r', 'camera'))"
        assert run_installed("-c", program) == "<class 'fpplab_sim.devices.SimCamera'>\n"


@pytest.mark.whole
@pytest.mark.parametrize(
    ("words", "extra"),
    [
        (["view", "."], "viewer"),
        (["check", "--rig", "rig_bench"], "basler"),
        (["check", "--rig", "rig_demo"], "twin"),
        (["optimise", "pareto", "--rig", "rig_matched", "--out", "o"], "optimise"),
        (["serve", "--rig", "rig_matched"], "service"),
    ],
)
def test_a_missing_extra_is_named(run_installed: Run, words: list[str], extra: str) -> None:
    answer: dict[str, Any] = json.loads(run_installed("-m", "fpplab", *words, "--json", code=2))
    assert answer["error"].endswith(f"install it with: pip install 'fpplab[{extra}]'")
    assert answer["exit_code"] == 2


@pytest.mark.nightly
def test_captures_are_characterised_and_reconstructed(
    run_installed: Run, captures: Path, tmp_path: Path
) -> None:
    def fpplab(*words: object) -> dict[str, Any]:
        answer: dict[str, Any] = json.loads(run_installed("-m", "fpplab", *words, "--json"))
        return answer

    named = ("--frames", "{index:02d}.png", "--out")
    for name in [f"calseq{k}" for k in range(1, 6)]:
        fpplab("import", captures / name, "--plan", "plan_slstudio_board", *named, tmp_path / "board" / name)
    board, calibration = tmp_path / "board", tmp_path / "calibration.yaml"
    found = fpplab("characterise", board, "--target", "target_slstudio", "--out", calibration)
    assert max(found["leave_one_out"].values()) <= 0.14
    skull = tmp_path / "skull"
    fpplab("import", captures / "skull_2x3", "--plan", "plan_slstudio_skull", *named, skull)
    answer = fpplab("reconstruct", skull, "--calibration", calibration, "--out", skull / "cloud.ply")
    assert answer["verdict"] == "unverified"
    assert answer["points"] > 380_000
    assert (skull / "cloud.html").is_file()
