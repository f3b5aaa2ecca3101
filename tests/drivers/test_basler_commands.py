"""`fpplab camera save|load` on pylon's emulated cameras."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result
from typer.testing import CliRunner

from drivers.basler.transport import Pylon
from fpplab.cli.every import app
from fpplab.core.errors import ConfigError, DataError, DeviceError, DisconnectedError, FppError, StateError
from tests.drivers.basler_bench import SERIAL, SETTINGS, driver
from tests.support.pulsed_pylon import PulsedCamera, PulsedPylon

LEFT: dict[str, Any] = {"Width": 640, "OffsetX": 32, "Gamma": 2.0, "ExposureTime": 12300.0}
"""What another program has set."""


class Used(PulsedPylon):
    """A camera that keeps its settings when it is closed: as `LEFT`, or as a command leaves it."""

    def __init__(self, cameras: int = 1) -> None:
        super().__init__(cameras=cameras)
        self.settings = dict(LEFT)

    def on_opened(self, camera: PulsedCamera) -> None:
        super().on_opened(camera)
        for name, value in self.settings.items():
            getattr(camera.instant, name).SetValue(value)

    def on_closed(self, camera: PulsedCamera) -> None:
        if camera.instant.IsOpen():
            self.settings = {name: getattr(camera.instant, name).GetValue() for name in LEFT}
        super().on_closed(camera)


@pytest.fixture
def used(monkeypatch: pytest.MonkeyPatch) -> Iterator[Used]:
    yield from _used(monkeypatch, cameras=1)


@pytest.fixture
def two(monkeypatch: pytest.MonkeyPatch) -> Iterator[Used]:
    yield from _used(monkeypatch, cameras=2)


def _used(monkeypatch: pytest.MonkeyPatch, cameras: int) -> Iterator[Used]:
    bench = Used(cameras)
    bench.start()
    for module in ("drivers.basler.transport", "drivers.basler.camera"):
        monkeypatch.setattr(f"{module}.Pylon", lambda: bench)
    yield bench
    bench.close()


def run(*words: object) -> Result:
    return CliRunner().invoke(app, ["camera", *map(str, words), "--json"])


def said(*words: object) -> dict[str, Any]:
    result = run(*words)
    assert result.exit_code == 0, result.output
    found: dict[str, Any] = json.loads(result.stdout)
    return found


def refused(kind: type[FppError], *words: object) -> str:
    error = run(*words).exception
    assert isinstance(error, kind)
    return str(error)


def test_settings_are_saved_as_they_were_left(used: Used, tmp_path: Path) -> None:
    file = tmp_path / "camera.pfs"
    assert said("save", file) == {"settings": str(file), "model": "Emulation", "serial": SERIAL}
    lines = dict(line.split("\t")[:2] for line in file.read_text().splitlines() if "\t" in line)
    assert {name: float(lines[name]) for name in LEFT} == LEFT
    assert used.settings == LEFT, "saving changes nothing"


def test_settings_are_loaded_and_stay(used: Used, tmp_path: Path) -> None:
    file = tmp_path / "camera.pfs"
    said("save", file)
    used.settings = {"Width": 1024, "OffsetX": 0, "Gamma": 1.0, "ExposureTime": 500.0}
    assert said("load", file) == {"settings": str(file), "model": "Emulation", "serial": SERIAL}
    assert used.settings == LEFT


def test_what_is_saved_serves_a_rig(used: Used, tmp_path: Path) -> None:
    file = tmp_path / "camera.pfs"
    said("save", file)
    with driver(used, features=str(file)) as camera:
        camera.configure(SETTINGS)
        assert camera.snap()


@pytest.mark.parametrize("command", ["save", "load"])
def test_refused_while_another_program_takes_frames(used: Used, tmp_path: Path, command: str) -> None:
    said("save", tmp_path / "camera.pfs")
    used.settings = {}
    with driver(used) as camera:
        camera.configure(SETTINGS)
        camera.arm(1)
        file = tmp_path / ("camera.pfs" if command == "load" else "other.pfs")
        assert "another program has the camera open; close it there" in refused(StateError, command, file)
        assert camera.read(1.0).index == 0
    assert not (tmp_path / "other.pfs").exists()


def test_a_file_that_does_not_fit(used: Used, tmp_path: Path) -> None:
    file = tmp_path / "camera.pfs"
    assert "camera.pfs: there is no such file" in refused(ConfigError, "load", file)
    said("save", file)
    file.write_text(file.read_text().replace("Width\t640\n", "Width\t99999\n"))
    assert "camera.pfs: does not fit the camera" in refused(ConfigError, "load", file)


def test_outputs_that_are_refused(used: Used, tmp_path: Path) -> None:
    file = tmp_path / "camera.pfs"
    file.write_text("mine")
    assert "exists already; name another output, or add --force" in refused(ConfigError, "save", file)
    assert file.read_text() == "mine"
    said("save", file, "--force")
    assert "Width\t640" in file.read_text()
    assert "must end in .pfs" in refused(ConfigError, "save", tmp_path / "camera.txt")
    assert "cannot be written" in refused(DataError, "save", file / "camera.pfs")


def test_one_of_two_is_named(two: Used, tmp_path: Path) -> None:
    file = tmp_path / "camera.pfs"
    assert "2 cameras are connected; name one of 0815-0000, 0815-0001" in refused(DeviceError, "save", file)
    assert said("save", file, "--serial", "0815-0001")["serial"] == "0815-0001"


def test_none_is_there(used: Used, tmp_path: Path) -> None:
    file = tmp_path / "camera.pfs"
    assert "serial number 4711" in refused(DisconnectedError, "save", file, "--serial", "4711")
    used.unplug()
    assert "no camera is connected" in refused(DisconnectedError, "save", file)


def test_pylon_itself_is_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without anything in between, as on a bench."""
    monkeypatch.setenv("PYLON_CAMEMU", "1")
    assert said("save", tmp_path / "camera.pfs")["serial"] in Pylon().cameras()
