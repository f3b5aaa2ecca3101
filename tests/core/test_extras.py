"""Extras: what brings a module, and what is said where it is missing."""

import pickle
import re
import sys
import tomllib
from pathlib import Path

import pytest

from fpplab.core import extras
from fpplab.core.errors import ConfigError
from fpplab.core.extras import EXTRAS, MissingExtraError, extra_of, missing_extra, need_extra
from fpplab.core.plugins import COMMANDS, load_plugin
from fpplab.devices.backends import load_backend
from tests.support.commands import Command

PROJECT = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
MODULES = {
    "bpy": "bpy",
    "distributed": "distributed",
    "fastapi": "fastapi",
    "fastapi-offline": "fastapi_offline",
    "genicam": "genicam",
    "harvesters": "harvesters",
    "hidapi": "hid",
    "laspy": "laspy",
    "lxml": "lxml",
    "optuna": "optuna",
    "pyarrow": "pyarrow",
    "pye57": "pye57",
    "pypylon": "pypylon",
    "pysdl2": "sdl2",
    "pysdl2-dll": "sdl2",
    "pyserial": "serial",
    "pyusb": "usb",
    "rerun-sdk": "rerun",
    "scikit-image": "skimage",
    "uvicorn": "uvicorn",
}
"""What each package of an extra is imported as."""


def test_every_extra_of_the_project_is_known_and_in_all() -> None:
    stated = PROJECT["optional-dependencies"]
    assert {*stated} == {*EXTRAS, "all", "dev"}
    assert stated["all"] == [f"fpplab[{','.join(e for e in stated if e not in ('all', 'dev'))}]"]
    for extra in EXTRAS:
        for line in stated[extra]:
            module = MODULES[re.split(r"[^\w-]", line, maxsplit=1)[0]]
            assert module in EXTRAS[extra] or extra == "lightcrafter", (extra, line)


def test_no_module_of_an_extra_is_loaded_by_a_dependency_of_the_core() -> None:
    core = {re.split(r"[^\w-]", line, maxsplit=1)[0] for line in PROJECT["dependencies"]}
    assert not core & {*MODULES}


@pytest.mark.parametrize(
    ("module", "extra"), [("rerun.blueprint", "viewer"), ("bpy", "twin"), ("dask", "optimise"), ("numpy", "")]
)
def test_what_brings_a_module(module: str, extra: str) -> None:
    assert extra_of(module) == extra


def test_the_sentence_names_the_command() -> None:
    error = MissingExtraError("rerun")
    assert str(error) == "rerun is not installed; install it with: pip install 'fpplab[viewer]'"
    assert error.exit_code == ConfigError.exit_code == 2
    again = pickle.loads(pickle.dumps(error))
    assert (type(again), str(again)) == (MissingExtraError, str(error))


def test_only_a_missing_module_of_an_extra_is_one() -> None:
    assert str(missing_extra(ModuleNotFoundError("x", name="optuna.trial"))) == str(
        MissingExtraError("optuna")
    )
    assert missing_extra(ModuleNotFoundError("x", name="numpy.nothing")) is None
    assert missing_extra(ModuleNotFoundError("x")) is None
    assert missing_extra(ImportError("x", name="optuna")) is None  # it is there, and does not load
    assert missing_extra(ValueError("optuna")) is None


def test_it_is_looked_for_and_not_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[str] = []
    monkeypatch.setattr(extras, "find_spec", seen.append)
    with pytest.raises(MissingExtraError, match=r"pip install 'fpplab\[twin\]'"):
        need_extra("bpy")
    monkeypatch.setattr(extras, "find_spec", lambda name: seen)
    need_extra("bpy")
    assert seen == ["bpy"]


def test_a_rig_file_whose_driver_lacks_its_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "lacking.py").write_text("import pypylon\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("FPPLAB_ALLOW_BACKEND", "lacking")
    monkeypatch.setitem(sys.modules, "pypylon", None)
    with pytest.raises(ConfigError) as caught:
        load_backend("lacking:Camera", "rig.yaml", "camera")
    assert str(caught.value) == (
        "rig.yaml: 'camera.backend' is 'lacking:Camera': pypylon is not installed; install it with: "
        "pip install 'fpplab[basler]'"
    )


def test_a_plugin_that_lacks_its_library(monkeypatch: pytest.MonkeyPatch) -> None:
    class Entry:
        def load(self) -> None:
            raise ModuleNotFoundError("No module named 'serial'", name="serial")

    monkeypatch.setattr("fpplab.core.plugins.find_entries", lambda group: {"x": Entry()})
    with pytest.raises(MissingExtraError, match=r"pip install 'fpplab\[stage\]'"):
        load_plugin(COMMANDS, "x")


@pytest.mark.whole
def test_a_command_that_lacks_its_library(fpplab: Command, tmp_path: Path) -> None:
    (tmp_path / "sitecustomize.py").write_text("import sys\nsys.modules['rerun'] = None\n", encoding="utf-8")
    path = f"{Path(__file__).parents[2]}:{tmp_path}:{':'.join(sys.path)}"
    done = fpplab("view", tmp_path, "--json", env={"PYTHONPATH": path})
    said = "rerun is not installed; install it with: pip install 'fpplab[viewer]'"
    assert (done.code, done.json) == (2, {"error": said, "exit_code": 2})
    assert done.err == f"fpplab: {said}\n"
