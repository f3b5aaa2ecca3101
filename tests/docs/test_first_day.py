"""The commands of docs/how-to/first-day.md, each on emulated devices, print what the page shows."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from docs.generate.pages import ROOT, blocks, commands, fits
from drivers.clock import SteppedClock
from drivers.emulators.bench import EmulatedFixture
from drivers.emulators.dlpc350 import STRICT
from fpplab.calibration.model import Calibration
from fpplab.cli import app
from fpplab.devices.discovery import FoundDevices
from fpplab.devices.rig import Rig
from fpplab.simulation.arrangeable import Arrangeable
from tests.drivers.flash_board import Bench
from tests.drivers.flash_files import maker_firmware

PAGE = ROOT / "docs" / "how-to" / "first-day.md"
EMULATED = """
bench: {backend: "drivers.emulators.bench:EmulatedBench", optics: rig_demo_quick.yaml, firmware: patterns.bin}
fixture: {backend: "drivers.emulators.bench:EmulatedFixture"}
"""
"""What turns the page's rig file into one of emulated devices."""
CAMERA = {"Emulation": "acA5472-17um", "0815-0000": "21734321", "BaslerCamEmu": "BaslerUsb, 5 Gbit/s"}
"""What the page says of its camera in place of the emulated one."""


def shown_commands() -> Iterator[tuple[str, list[str]]]:
    """Each command of the page with the lines that it prints."""
    for block in blocks(PAGE):
        if block.language == "console":
            yield from commands(block)


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the page's files, and a computer with one projector and one camera."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "DLPR350PROM.bin").write_bytes(maker_firmware())
    for block in (one for one in blocks(PAGE) if one.language == "yaml"):
        assert block.file_name, f"the first line names no file: {block.text}"
        text = block.text.replace("21734321", "0815-0000", 1)
        if block.file_name == "rig_first.yaml":
            text = text.replace("bits: 8", "bits: 8, roi: [0, 0, 684, 456]", 1) + EMULATED
        (tmp_path / block.file_name).write_text(text, encoding="utf-8")
    clock = SteppedClock()
    board = Bench(maker_firmware(), STRICT, clock)
    monkeypatch.setitem(sys.modules, "hid", board.hid)
    monkeypatch.setattr("drivers.clock.RealClock", lambda: clock)
    monkeypatch.setattr("drivers.discovery.usb_devices", lambda: ([], []))
    for others in ("displays", "video_cameras", "producers"):  # of the computer that runs the test
        monkeypatch.setattr(f"drivers.computer_discovery.{others}", lambda: FoundDevices([], []))
    monkeypatch.setattr("serial.tools.list_ports.comports", list)
    monkeypatch.setenv("PYLON_CAMEMU", "1")
    monkeypatch.setattr("fpplab.acquisition.rig_check.disk_finding", lambda *_: None)  # that of this computer
    return tmp_path


def characterised(folder: Path) -> Calibration:
    """What a characterisation of the emulated rig would find without error."""
    with Rig.load(folder / "rig_first.yaml") as rig:
        assert isinstance(rig.fixture, EmulatedFixture)
        simulation = rig.fixture.bench.optics_rig.simulation
        assert isinstance(simulation, Arrangeable)
        return simulation.studio().calibration(0.0)


@pytest.mark.slow
def test_each_command_prints_what_the_page_shows(desk: Path) -> None:
    seen = 0
    for command, shown in shown_commands():
        if "--calibration" in command:
            characterised(desk).save(desk / "calibration.yaml")
        program, *words = shlex.split(command)
        assert program == "fpplab"
        done = CliRunner().invoke(app, words)
        assert done.exit_code == 0, f"{command}\n{done.output}\n{done.exception}"
        printed = done.stdout
        for emulated, real in CAMERA.items():
            printed = printed.replace(emulated, real)
        print(f"$ {command}\n{printed}")
        assert fits(shown, printed.splitlines()), f"{command} prints\n{printed}\nnot\n" + "\n".join(shown)
        seen += 1
    assert seen >= 8


def test_the_page_names_every_step_of_the_check() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for step in ("link", "lamp", "one pulse", "ten pulses", "rate", "exposure", "focus"):
        assert f"{step}: ok" in text
    for picture in re.findall(r"\]\((first-day-\w+\.svg)\)", text):
        assert (PAGE.parent / picture).is_file()
