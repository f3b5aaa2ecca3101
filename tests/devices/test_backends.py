"""Which modules a rig file may have imported."""

import importlib
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from fpplab.core.errors import ConfigError
from fpplab.devices import backends
from fpplab.devices.backends import ALLOWED, load_backend

OPERATOR = "fpplab.devices.operator:Operator"


@pytest.fixture
def foreign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A module that leaves a file when it is imported, and nothing allowed but fpplab's own."""
    ran = tmp_path / "ran"
    (tmp_path / "foreign_optics.py").write_text(
        f"open({str(ran)!r}, 'w').close()\nclass Lamp: pass\n", encoding="utf-8"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "foreign_optics", raising=False)
    monkeypatch.delenv(ALLOWED, raising=False)
    return ran


def test_a_foreign_module_is_not_imported(foreign: Path) -> None:
    with pytest.raises(ConfigError, match=r"'camera.backend' is .*--allow-backend foreign_optics"):
        load_backend("foreign_optics:Lamp", "rig.yaml", "camera")
    assert not foreign.exists()


@pytest.mark.parametrize("allowed", ["foreign_optics", "other,foreign_optics"])
def test_one_that_the_user_allows(foreign: Path, allowed: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ALLOWED, "foreign")  # no prefix of a name
    with pytest.raises(ConfigError, match="is not part of fpplab"):
        load_backend("foreign_optics:Lamp", "rig.yaml", "camera")
    monkeypatch.setenv(ALLOWED, allowed)
    assert load_backend("foreign_optics:Lamp", "rig.yaml", "camera").__name__ == "Lamp"
    assert foreign.exists()


def test_one_that_an_installed_package_announces(foreign: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    entry = EntryPoint("lamp", "foreign_optics:Lamp", "fpplab.backends")
    monkeypatch.setattr(backends, "_installed", lambda: [entry])
    assert load_backend("foreign_optics:Lamp", "rig.yaml", "camera").__name__ == "Lamp"
    with pytest.raises(ConfigError, match="foreign_optics announces Lamp as a backend, not Other"):
        load_backend("foreign_optics:Other", "rig.yaml", "camera")


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        (
            "own_driver:Own",
            "class Own:\n    def f(self)\n        pass\n",
            r"expected ':' \(own_driver.py, line 2\)",
        ),
        ("own_driver:Own", "raise RuntimeError('no licence')", "cannot be loaded .RuntimeError: no licence"),
        (
            "own_driver:Own",
            "import fpplab.devices as d\nclass Own(d.Stage): pass\n",
            "Own lacks _caps, _close, .*stage.py",
        ),
        ("own_driver:Owm", "class Own: pass\n", "own_driver has no Owm"),
        ("own_driver.py:Own", "class Own: pass\n", "named without .py: 'own_driver:Own'"),
        ("own_drive:Own", "", "add the folder of own_drive to PYTHONPATH"),
    ],
)
def test_what_is_wrong_with_a_driver_is_said_of_the_driver(
    name: str, content: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_driver.py").write_text(content)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "own_driver", raising=False)
    monkeypatch.setenv(ALLOWED, "own_driver,own_drive")
    with pytest.raises(ConfigError, match=said):
        load_backend(name, "rig.yaml", "stage")


@pytest.mark.parametrize("name", ["numpy.f2py.__main__:X", "fpplab.__main__:X", "drivers.x.__main__:X"])
def test_a_program_is_never_a_backend(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ALLOWED, "numpy")
    with pytest.raises(ConfigError, match="is a program and not a backend"):
        load_backend(name, "rig.yaml", "camera")


def test_a_module_that_ends_the_program(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "leaving.py").write_text("raise SystemExit(0)\n", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv(ALLOWED, "leaving")
    with pytest.raises(ConfigError, match="cannot be loaded"):
        load_backend("leaving:X", "rig.yaml", "camera")


@pytest.mark.parametrize(
    ("name", "found"),
    [("virtual_camera", "SimCamera"), ("operator", "Operator"), ("sim.devices:SimCamera", "SimCamera")],
)
def test_one_by_its_announced_name_or_by_module_and_class(name: str, found: str) -> None:
    assert load_backend(name, "rig.yaml", "camera").__name__ == found


def test_an_unknown_name_is_answered_with_the_one_that_was_meant() -> None:
    with pytest.raises(ConfigError, match=r"'basler2': there is no such backend; did you mean basler\? inst"):
        load_backend("basler2", "rig.yaml", "camera")


def test_fpplabs_own_names_come_first(monkeypatch: pytest.MonkeyPatch) -> None:
    entries = [EntryPoint("operator", place, "fpplab.backends") for place in ("abc:X", OPERATOR)]
    monkeypatch.setattr(backends, "_installed", lambda: entries)
    assert load_backend("operator", "rig.yaml", "fixture").__name__ == "Operator"


def test_a_package_that_happens_to_be_called_as_one_of_the_checkout(
    foreign: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a wheel is installed, `sim` may be somebody else's; the name leads to fpplab's own."""
    monkeypatch.setattr(backends, "IN_WHEELS", {"foreign_optics": "foreign_renamed"})
    (foreign.parent / "foreign_renamed.py").write_text("class Lamp: pass\n", encoding="utf-8")
    importlib.invalidate_caches()
    found = load_backend("foreign_optics:Lamp", "rig.yaml", "camera")
    assert found.__module__ == "foreign_renamed"
    assert not foreign.exists()
