"""The commands of docs/how-to/first-day.md, each on emulated devices, print what the page shows."""

import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from docs.generate.pages import ROOT, blocks, commands, fits
from drivers.clock import SteppedClock
from drivers.dlp4500.device import LedLevels
from drivers.dlp4500.sequence import MIN_GAP_US
from drivers.emulators.dlpc350 import STRICT, Dlpc350, Dlpc350Policy, EmulatedHid
from fpplab.cli.every import app
from fpplab.core.errors import CapabilityError, ProtocolError
from fpplab.devices.backends import ALLOWED
from fpplab.devices.discovery import FoundDevices
from fpplab.setup.rig_check.steps import LIMITS
from tests.drivers.flash_board import Bench
from tests.drivers.flash_files import maker_firmware

pytestmark = pytest.mark.timeout(1800)  # a characterisation and a scan, among others
PAGE = ROOT / "docs" / "how-to" / "first-day.md"
WIRED_FROM = "## 7. "
"""The section from which on there is a trigger cable."""
BENCH = """
bench:
  backend: emulated_bench
  optics: rig_demo_quick.yaml
  firmware: patterns.bin
  faults: {{cut: {cut}}}
"""
"""What turns the page's rig file into one of emulated devices."""
PERSON = "tests.docs.person:Person"
"""Stands in for the operator."""


def shown_commands() -> Iterator[tuple[bool, str, list[str]]]:
    """Each command of the page: whether there is a trigger cable, and the lines that a terminal shows."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    wired_from = next(number for number, line in enumerate(lines, 1) if line.startswith(WIRED_FROM))
    for block in blocks(PAGE):
        if block.language == "console":
            for command, shown in commands(block):
                yield block.line > wired_from, command, shown


def write_rig(folder: Path, *, is_wired: bool) -> None:
    """Save the page's rig file, with emulated devices in place of real ones."""
    (text,) = (block.text for block in blocks(PAGE) if block.file_name == "rig_first.yaml")
    for real, emulated in (
        ("bits: 8", "bits: 8, roi: [0, 0, 684, 456]"),
        ("backend: operator", f'backend: "{PERSON}"'),
    ):
        assert real in text
        text = text.replace(real, emulated, 1)
    text += BENCH.format(cut=str(not is_wired).lower())
    (folder / "rig_first.yaml").write_text(text, encoding="utf-8")


def seen_at_a_terminal(words: list[str]) -> tuple[list[str], int]:
    """What a command shows there apart from its progress, and its exit code."""
    done = CliRunner().invoke(app, words, input="y\n")
    if isinstance(done.exception, Exception):
        raise done.exception
    output = done.output.replace("[y/N] ", "[y/N] y\n")  # the answer ends the line
    return [line for line in output.splitlines() if not line.endswith(" …")], done.exit_code


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the page's files, and a computer with one projector and one camera."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "DLPR350PROM.bin").write_bytes(maker_firmware())
    for block in (one for one in blocks(PAGE) if one.language == "yaml"):
        assert block.file_name, f"the first line names no file: {block.text}"
        (tmp_path / block.file_name).write_text(block.text, encoding="utf-8")
    clock = SteppedClock()
    board = Bench(maker_firmware(), STRICT, clock)
    monkeypatch.setitem(sys.modules, "hid", board.hid)
    monkeypatch.setattr("drivers.clock.RealClock", lambda: clock)
    monkeypatch.setattr("drivers.discovery.usb_devices", lambda: ([], []))
    for others in ("displays", "video_cameras", "producers"):  # of the computer that runs the test
        monkeypatch.setattr(f"drivers.computer_discovery.{others}", lambda: FoundDevices([], []))
    monkeypatch.setattr("serial.tools.list_ports.comports", list)
    monkeypatch.setenv("PYLON_CAMEMU", "1")
    monkeypatch.setenv(ALLOWED, PERSON.partition(":")[0])
    monkeypatch.setattr("fpplab.core.confirmation._has_terminal", lambda: True)
    monkeypatch.setattr("fpplab.setup.rig_check.check.disk_finding", lambda *_: None)  # that of this computer
    return tmp_path


@pytest.mark.nightly
def test_each_command_prints_what_the_page_shows(desk: Path) -> None:
    """From the boxes to the scan in one folder, each command with the files of those before it."""
    seen = 0
    for is_wired, command, shown in shown_commands():
        write_rig(desk, is_wired=is_wired)
        program, *words = shlex.split(command)
        assert program == "fpplab"
        printed, code = seen_at_a_terminal(words)
        failing = re.fullmatch(r"\[exit code (\d+)\]", shown[-1])
        expected = shown[:-1] if failing else shown
        print(f"$ {command}", *printed, sep="\n")
        assert code == (int(failing[1]) if failing else 0), f"{command} ends with {code}"
        assert fits(expected, printed), "\n".join([f"{command} prints", *printed, "not", *expected])
        seen += 1
    assert seen >= 11
    write_rig(desk, is_wired=False)
    plan = (desk / "plan_first.yaml").read_text(encoding="utf-8")
    (desk / "plan_stepped.yaml").write_text(plan.replace("triggered", "stepped"), encoding="utf-8")
    command = (
        "scan --rig rig_first.yaml --plan plan_stepped.yaml --calibration calibration.yaml --item pyramid"
    )
    printed, code = seen_at_a_terminal([*command.split(), "--out", "stepped"])
    assert code == 0
    assert "verdict: unverified" in printed, "a stepped scan needs no cable"


def test_the_page_names_every_step_of_the_check() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for step in ("link", "lamp", "one pulse", "ten pulses", "rate", "exposure", "focus"):
        assert f"{step}: ok" in text
    for picture in re.findall(r"\]\((first-day-\w+\.svg)\)", text):
        assert (PAGE.parent / picture).is_file()


def test_the_message_about_replies_is_the_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SteppedClock()
    board = Dlpc350(clock, [], Dlpc350Policy(echoes_sequence=False))
    monkeypatch.setitem(sys.modules, "hid", EmulatedHid(board))
    monkeypatch.setattr("drivers.clock.RealClock", lambda: clock)
    told = CliRunner().invoke(app, ["dlp4500", "status"]).exception
    assert isinstance(told, ProtocolError)
    assert f"fpplab: {told}\n" in PAGE.read_text(encoding="utf-8")


@pytest.mark.whole
def test_a_plan_that_is_not_in_flash_is_refused(desk: Path) -> None:
    """As the page says of a characterisation without its plan."""
    words = "build plan_first.yaml --base DLPR350PROM.bin --out patterns.bin"
    assert CliRunner().invoke(app, ["dlp4500", *words.split()]).exit_code == 0
    write_rig(desk, is_wired=True)
    words = "characterise --rig rig_first.yaml --target target_paper --out other.yaml --poses 3"
    told = CliRunner().invoke(app, words.split()).exception
    assert isinstance(told, CapabilityError)
    assert "does not contain" in str(told)


def test_the_means_of_the_output_follow_from_the_times() -> None:
    """What a voltmeter shows, by the plan's exposure, the projector's gap, and the pauses of the check."""
    text = PAGE.read_text(encoding="utf-8")
    exposure_s = 0.033332
    period_s = exposure_s + 1e-6 * MIN_GAP_US
    run, pulses = exposure_s / period_s, exposure_s / (period_s + LIMITS.safe_gap_s)
    assert f"{1e3 * period_s:.3f} ms, which is {100 * run:.1f} % of the time" in text
    assert f"a mean of {3.3 * run:.2f} V or {1.8 * run:.2f} V" in text
    assert f"of {1e3 * (period_s + LIMITS.safe_gap_s):.3f} ms, or {100 * pulses:.0f} %" in text
    assert f"{3.3 * pulses:.2f} V or {1.8 * pulses:.2f} V" in text


def test_the_default_levels_of_the_leds_are_those_of_the_driver() -> None:
    levels = ", ".join(f"{name} {level}" for name, level in LedLevels().model_dump().items())
    assert f"{levels} of 255" in PAGE.read_text(encoding="utf-8")
