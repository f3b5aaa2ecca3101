"""An emulated LightCrafter on this computer's USB, to learn its commands or to try a rig file."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from drivers.clock import RealClock
from drivers.dlp4500.flash.firmware import Firmware, arrange_patterns
from drivers.dlp4500.index import FlashIndex
from drivers.dlp4500.packing import pack_images
from drivers.dlp4500.protocol import DisplayMode, Run
from drivers.dlp4500.sequence import SIZE
from drivers.emulators.dlpc350.firmware import Dlpc350
from drivers.emulators.dlpc350.light import ProjectedLight
from drivers.emulators.dlpc350.loader import FlashedDlpc350
from drivers.emulators.dlpc350.sequencer import Sequencer
from drivers.emulators.dlpc350.usb import EmulatedHid
from drivers.emulators.dlpc350.usbip import UsbIpAttachment
from fpplab.cli import console
from fpplab.core import config
from fpplab.core.conventions import Lattice
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan

DEFAULT_PLAN = "plan_scan.yaml"  # plan whose patterns are in flash when no firmware file is given


@contextmanager
def serve_projector(firmware: Path | None = None) -> Iterator[dict[str, str]]:
    """Run an emulated projector on this computer's USB in real time; a context manager."""
    with TemporaryDirectory(prefix="fpplab-") as folder:
        controller, index = _from_firmware(firmware) if firmware else _from_default_plan(Path(folder))
        flash = f", flash: {index}" if index.exists() else ""
        with UsbIpAttachment(EmulatedHid(controller)) as attachment, _state_messages(attachment):
            yield {
                "serial": attachment.hid.serial,
                "projector": f"{{backend: dlp4500{flash}}}",
                "try": "fpplab devices; fpplab dlp4500 status",
            }


def _from_firmware(firmware: Path) -> tuple[Dlpc350, Path]:
    content = Firmware.load(firmware).content
    return FlashedDlpc350(RealClock(), content), firmware.absolute().with_suffix(".yaml")


def _from_default_plan(folder: Path) -> tuple[Dlpc350, Path]:
    patterns = make_patterns(Plan.load(DEFAULT_PLAN), SIZE, Lattice.DIAMOND)
    slots = arrange_patterns(patterns)
    index = folder / "patterns.yaml"
    index.write_text(config.dump(FlashIndex.of(patterns, slots)), encoding="utf-8")
    return Dlpc350(RealClock(), list(pack_images(patterns, slots))), index


@contextmanager
def _state_messages(attachment: UsbIpAttachment) -> Iterator[None]:
    ended = threading.Event()

    def report() -> None:
        reported = ""
        while not ended.wait(0.1):
            with attachment.lock:
                state = (
                    describe_state(attachment.hid.controller) if attachment.hid.is_plugged else "off the bus"
                )
            if state != reported:
                console.log_status(state)
                reported = state

    reporter = threading.Thread(target=report, daemon=True)
    reporter.start()
    try:
        yield
    finally:
        ended.set()
        reporter.join()


def describe_state(controller: Dlpc350) -> str:
    if isinstance(controller, FlashedDlpc350) and controller.loader is not None:
        return "boot loader: its flash can be written, it shows nothing"
    if controller.is_asleep():
        return "standby"
    controller.advance()
    sequencer = controller.sequencer
    began_s = sequencer.shown.begin_s if sequencer.running and sequencer.shown else controller.clock.now()
    light = controller.light_at(began_s)
    leds = ", ".join(f"{name} {level:.0%}" for name, level in light.levels.items()) if light else "dark"
    if controller.mode is DisplayMode.VIDEO:
        return f"video mode: {leds}"
    return f"pattern mode, {_sequence(sequencer, light)}: {leds}"


def _sequence(sequencer: Sequencer, light: ProjectedLight | None) -> str:
    tables = sequencer.tables
    if sequencer.running and tables is not None and len(tables.entries) > 1:
        exposure_s, _ = tables.times[0]
        times = "over and over" if tables.repeat else "once"
        return f"{len(tables.entries)} patterns of {1e3 * exposure_s:g} ms {times}"
    if light is not None:
        return f"pattern {light.number} of image {light.image}, {light.depth} bits"
    return "paused" if sequencer.state is Run.PAUSE else "stopped"
