"""What is found and what is said to be missing, with the libraries' own answers in their place."""

import builtins
import os
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import genicam
import hid
import pytest
import usb.core
from pypylon import pylon
from serial.tools import list_ports

from drivers import computer_discovery, computer_settings, discovery
from drivers.discovery import BASLER_VENDOR
from drivers.display import DisplayProjector, window
from drivers.display.screen import DisplayInfo
from drivers.dlp4500 import Dlp4500
from drivers.dlp4500.transport import PRODUCT, VENDOR
from drivers.gentl import GentlCamera, listing
from drivers.gentl.listing import ListedCamera
from fpplab.core.errors import CapabilityError, DeviceError
from fpplab.devices import DeviceInfo
from fpplab.devices.discovery import FoundDevice
from fpplab.devices.rig import Rig
from tests.drivers.grbl_stage import Bench

REAL_DISPLAYS = computer_discovery.displays


class Computer:
    """What is plugged into it; the libraries are made to answer accordingly."""

    def __init__(self) -> None:
        self.usb: list[SimpleNamespace] = []
        self.pylon: list[SimpleNamespace] = []
        self.hid: list[dict[str, Any]] = []
        self.ports: list[SimpleNamespace] = []
        self.forbidden: set[str] = set()

    def plug_usb(self, vendor: int, product: int, serial: str | None, speed: int) -> None:
        number = len(self.usb) + 1
        self.usb.append(
            SimpleNamespace(
                idVendor=vendor, idProduct=product, serial_number=serial, bus=1, address=number, speed=speed
            )
        )

    def plug_camera(self, serial: str, speed: int = 4, shown: bool = True) -> None:
        self.plug_usb(BASLER_VENDOR, 0xBA02, serial, speed)
        if shown:
            model = "acA5472-17um"
            self.pylon.append(
                SimpleNamespace(
                    GetModelName=lambda: model,
                    GetSerialNumber=lambda: serial,
                    GetDeviceClass=lambda: "BaslerUsb",
                )
            )

    def plug_projector(self, shown: bool = True) -> None:
        self.plug_usb(VENDOR, PRODUCT, "LCR3", 3)
        if shown:
            for interface in (0, 1):
                self.hid.append(
                    {
                        "interface_number": interface,
                        "product_string": "DLPC350",
                        "serial_number": "LCR3",
                        "path": b"1-2:1.0",
                    }
                )

    def plug_stage(self, port: str, serial: str | None = "AB12") -> None:
        self.ports.append(
            SimpleNamespace(
                device=port,
                description="Arduino Uno",
                serial_number=serial,
                vid=0x2341,
                pid=0x0043,
                hwid="USB",
            )
        )


@pytest.fixture
def computer(monkeypatch: pytest.MonkeyPatch) -> Computer:
    made = Computer()
    factory = SimpleNamespace(EnumerateDevices=lambda: made.pylon)
    monkeypatch.setattr(pylon, "TlFactory", SimpleNamespace(GetInstance=lambda: factory))
    monkeypatch.setattr(hid, "enumerate", lambda vendor, product: made.hid)
    monkeypatch.setattr(list_ports, "comports", lambda: made.ports)
    monkeypatch.setattr(usb.core, "find", lambda find_all: iter(made.usb))
    monkeypatch.setattr(computer_discovery, "displays", lambda: discovery.FoundDevices([], []))
    monkeypatch.setattr(computer_discovery, "VIDEO_CLASS", Path("/nowhere"))
    monkeypatch.delenv(computer_discovery.PRODUCER_PATH, raising=False)
    monkeypatch.setattr(discovery, "_may_use", lambda node: str(node) not in made.forbidden)
    return made


def plain(devices: list[FoundDevice]) -> list[DeviceInfo]:
    return [DeviceInfo(d.kind, d.model, d.serial, d.link) for d in devices]


def test_nothing_is_found_and_nothing_missed_where_nothing_is(computer: Computer) -> None:
    assert discovery.find_devices() == discovery.FoundDevices([], [])


def test_a_whole_bench_is_listed(computer: Computer) -> None:
    computer.plug_camera("23456789")
    computer.plug_projector()
    computer.plug_stage("/dev/ttyACM0")
    found = discovery.find_devices()
    assert found.missing == []
    assert plain(found.devices) == [
        DeviceInfo("camera", "acA5472-17um", "23456789", "BaslerUsb, USB 3, 5 Gbit/s"),
        DeviceInfo("projector", "DLPC350", "LCR3", "USB 1-2:1.0, USB 2, 480 Mbit/s"),
        DeviceInfo("stage", "Arduino Uno", "AB12", "serial /dev/ttyACM0 (USB 2341:0043)"),
    ]


def test_a_camera_on_usb_2_is_said(computer: Computer) -> None:
    computer.plug_camera("23456789", speed=3)
    assert "camera 23456789: connected by USB 2, 480 Mbit/s; use a USB 3 port" in only(
        discovery.find_devices().missing
    )


@pytest.mark.parametrize(("node", "kind"), [("001", "camera 23456789"), ("002", "projector LCR3")])
def test_missing_permissions_on_usb_are_said(node: str, kind: str, computer: Computer) -> None:
    computer.plug_camera("23456789")
    computer.plug_projector()
    computer.forbidden.add(f"/dev/bus/usb/001/{node}")
    assert only(discovery.find_devices().missing).startswith(
        f"{kind}: this user may not open it; copy the udev rules"
    )


def test_a_camera_without_its_driver_is_said(computer: Computer) -> None:
    computer.plug_camera("23456789", shown=False)
    assert "pylon does not show it" in only(discovery.find_devices().missing)


def test_a_camera_whose_serial_number_is_hidden_has_a_place(computer: Computer) -> None:

    class Hidden(SimpleNamespace):
        @property
        def serial_number(self) -> str:
            raise ValueError("The device has no langid")

    computer.usb = [Hidden(idVendor=BASLER_VENDOR, idProduct=1, bus=2, address=7, speed=4)]
    assert only(discovery.find_devices().missing).startswith("camera at USB 2-7: ")


def test_a_projector_that_is_no_hid_device_is_said(computer: Computer) -> None:
    computer.plug_projector(shown=False)
    assert "without its HID interface" in only(discovery.find_devices().missing)


def test_a_port_that_may_not_be_opened_is_said(computer: Computer) -> None:
    computer.plug_stage("/dev/ttyACM0")
    computer.forbidden.add("/dev/ttyACM0")
    assert "stage on /dev/ttyACM0: this user may not open it; add yourself" in only(
        discovery.find_devices().missing
    )


def test_an_adapter_without_a_driver_is_said(computer: Computer) -> None:
    computer.plug_usb(0x1A86, 0x7523, None, 2)
    assert only(discovery.find_devices().missing) == (
        "stage at USB 1-1: CH340 is on USB without a serial port; install its driver"
    )


def test_an_adapter_that_brltty_claims_is_said(
    computer: Computer, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "85-brltty.rules").write_text('ENV{PRODUCT}=="1a86/7523/*"\n', encoding="utf-8")
    monkeypatch.setattr(computer_settings, "UDEV_RULES", (tmp_path,))
    computer.plug_usb(0x1A86, 0x7523, None, 2)
    assert "brltty, for braille displays, claims it" in only(discovery.find_devices().missing)


def test_memory_for_usb_is_said_where_a_camera_needs_it(
    computer: Computer, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(computer_settings, "usb_memory", lambda: "computer: too little; more")
    computer.plug_usb(0x1A86, 0x7523, None, 4)
    assert "computer: too little; more" not in discovery.find_devices().missing
    computer.plug_camera("1234", 4)
    assert "computer: too little; more" in discovery.find_devices().missing


def test_ports_of_the_mainboard_are_left_out(computer: Computer) -> None:
    computer.plug_stage("/dev/ttyS0")
    computer.ports[0].hwid = "n/a"
    assert discovery.find_devices().devices == []


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (usb.core.NoBackendError("No backend available"), "pyusb finds no libusb; install libusb-1.0-0"),
        (usb.core.USBError("Access denied", errno=13), "libusb fails ([Errno 13] Access denied)"),
    ],
)
def test_unknown_speeds_are_said(
    error: Exception, words: str, computer: Computer, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(find_all: bool) -> None:
        raise error

    monkeypatch.setattr(usb.core, "find", broken)
    computer.plug_camera("23456789")
    found = discovery.find_devices()
    assert only(found.missing) == f"USB speeds are unknown: {words}"
    assert only(found.devices).link == "BaslerUsb"


@pytest.mark.parametrize("library", ["pypylon", "hid", "usb.core"])
def test_a_missing_library_hides_its_own_devices_alone(
    library: str, computer: Computer, monkeypatch: pytest.MonkeyPatch
) -> None:
    load = builtins.__import__

    def without(name: str, *rest: Any) -> Any:
        if name == library:
            raise ImportError(f"No module named '{library}'", name=library)
        return load(name, *rest)

    computer.plug_camera("23456789")
    computer.plug_projector()
    computer.plug_stage("/dev/ttyACM0")
    monkeypatch.delitem(sys.modules, library)
    monkeypatch.setattr(builtins, "__import__", without)
    found = discovery.find_devices()
    assert len(found.devices) == (3 if library == "usb.core" else 2)
    assert "does not load; install it" in only(found.missing)


def test_permissions_are_those_of_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    node = tmp_path / "001"
    assert discovery._may_use(node)  # a system without such files
    node.touch()
    assert discovery._may_use(node)
    monkeypatch.setattr(discovery.os, "access", lambda path, mode: False)
    assert not discovery._may_use(node)


def test_looking_sends_nothing_to_a_stage(computer: Computer) -> None:
    with Bench() as bench:
        computer.plug_stage(bench.terminal.port)
        assert len(discovery.find_devices().devices) == 1
        assert bench.heard == b""


def only(items: list[Any]) -> Any:
    """The one thing there is."""
    assert len(items) == 1, items
    return items[0]


# --- what a rig file would say of them


def display(index: int, size: tuple[int, int], is_main: bool = False) -> DisplayInfo:
    return DisplayInfo(index, f"HDMI-{index}", size, 60, is_main)


def test_every_device_has_a_section_that_its_driver_takes_and_an_example(computer: Computer) -> None:
    computer.plug_camera("23456789")
    computer.plug_projector()
    computer.plug_stage("/dev/ttyACM0")
    camera, projector, stage = discovery.find_devices().devices
    assert camera.section == {"backend": "basler", "serial": "23456789"}
    assert projector.section["flash"] == "patterns.yaml"
    assert stage.section == {"backend": "grbl", "port": "/dev/ttyACM0"}
    assert (camera.is_certain, projector.is_certain, stage.is_certain) == (True, True, False)
    for device in (camera, projector, stage):
        used = Rig.load(device.example).file
        assert getattr(used, device.kind) is not None or device.kind == "stage"


@pytest.fixture
def displays(computer: Computer, monkeypatch: pytest.MonkeyPatch) -> list[DisplayInfo]:
    listed: list[DisplayInfo] = []
    monkeypatch.setattr(window, "connected_displays", lambda: listed)
    monkeypatch.setattr(computer_discovery, "displays", REAL_DISPLAYS)
    return listed


def test_displays_are_projectors_but_the_main_one_is_not_taken_unasked(displays: list[DisplayInfo]) -> None:
    displays += [display(0, (2560, 1440), is_main=True), display(1, (1920, 1080))]
    main, second = discovery.find_devices().devices
    assert main.link == "2560 x 1440, 60 Hz, the main display"
    assert second.link == "1920 x 1080, 60 Hz"
    assert (main.is_certain, second.is_certain) == (False, True)
    assert second.section["display"] == 1
    assert second.section["size"] == [1920, 1080]
    DisplayProjector("projector", {k: v for k, v in second.section.items() if k != "backend"}, None)


def connector(folder: Path, name: str, modes: str, status: str = "connected") -> None:
    (folder / name).mkdir()
    (folder / name / "modes").write_text(modes, encoding="utf-8")
    (folder / name / "status").write_text(f"{status}\n", encoding="utf-8")


@pytest.mark.parametrize(
    ("size", "scale"),
    [
        ((2560, 1440), 1.5),
        ((1920, 1080), None),  # a mode of its own, though also half of the other display's
        ((3072, 1728), 1.25),
        ((2194, 1234), 1.75),
        ((912, 1140), None),  # made by xrandr, so that the kernel does not list it
    ],
)
def test_a_display_that_the_desktop_scales_is_told(
    displays: list[DisplayInfo],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    size: tuple[int, int],
    scale: float | None,
) -> None:
    connector(tmp_path, "card0-DP-1", "3840x2160\n1280x720\n")
    connector(tmp_path, "card0-HDMI-A-1", "1920x1080\n1920x1080i\n")
    connector(tmp_path, "card0-HDMI-A-2", "5120x2880\n", status="disconnected")
    monkeypatch.setattr(computer_discovery, "CONNECTORS", tmp_path)
    displays.append(display(1, size))
    found = discovery.find_devices()
    assert bool(found.devices[0].section) == (scale is None)
    told = [sentence for sentence in found.missing if "the desktop scales it" in sentence]
    assert [f"scales it by {scale:g}," in sentence for sentence in told] == ([True] if scale else [])


def test_a_lightcrafter_on_a_display_takes_its_patterns_from_it(
    displays: list[DisplayInfo], computer: Computer
) -> None:
    computer.plug_projector()
    displays += [display(0, (912, 1140), is_main=True), display(1, (1920, 1080))]
    assert discovery.find_devices().devices[0].section["flash"] == "patterns.yaml"
    displays.append(display(2, (912, 1140)))
    projector = discovery.find_devices().devices[0]
    assert projector.section["video"] == {"display": 2}
    assert "flash" not in projector.section
    Dlp4500("projector", {k: v for k, v in projector.section.items() if k != "backend"}, None)


def test_without_a_graphical_session_displays_are_missing(
    displays: list[DisplayInfo], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> list[DisplayInfo]:
        raise DeviceError("displays", "list", "SDL finds no displays (none)", "start a graphical session")

    monkeypatch.setattr(window, "connected_displays", refuse)
    sentence = only(discovery.find_devices().missing)
    assert sentence.startswith("displays are not looked for: SDL finds no displays")
    assert sentence.endswith("start a graphical session")


def test_video_cameras_are_listed_by_their_first_node(
    computer: Computer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for number, index, name in ((0, 0, "HD Webcam"), (1, 1, "HD Webcam"), (10, 0, "Second"), (2, 0, "First")):
        entry = tmp_path / f"video{number}"
        entry.mkdir()
        (entry / "index").write_text(f"{index}\n")
        (entry / "name").write_text(f"{name}\n")
    nodes = tmp_path / "dev"
    nodes.mkdir()
    for number in (0, 1, 2):
        (nodes / f"video{number}").touch()
    monkeypatch.setattr(computer_discovery, "VIDEO_CLASS", tmp_path)
    monkeypatch.setattr(computer_discovery, "VIDEO_NODES", nodes)
    found = discovery.find_devices()
    assert [d.model for d in found.devices] == ["HD Webcam", "First", "Second"]
    assert found.devices[0].section == {
        "backend": "video_camera",
        "device": str(nodes / "video0"),
    }
    assert only(found.missing).startswith(f"camera on {nodes / 'video10'}: this user may not open it")


@pytest.fixture
def makers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for the producers of makers."""
    folder = tmp_path / "maker"
    folder.mkdir()
    monkeypatch.setenv("GENICAM_GENTL64_PATH", f"{folder}{os.pathsep}")
    return folder


def test_cameras_of_a_producer_are_listed_with_the_section_that_opens_them(
    computer: Computer, makers: Path
) -> None:
    """A real producer, of the package `genicam`, that has three cameras without a sensor."""
    producer = makers / "viky.cti"
    producer.symlink_to(Path(genicam.__file__).with_name("viky.cti"))
    found = discovery.find_devices()
    assert found.missing == []
    assert [(d.kind, d.serial, d.example) for d in found.devices] == [
        ("camera", number, "rig_gentl.yaml") for number in "012"
    ]
    first = found.devices[0]
    assert first.model.endswith("Viky")
    assert first.link.endswith(", viky.cti")
    assert first.section == {"backend": "gentl", "producer": str(producer), "serial": "0"}
    with pytest.raises(CapabilityError, match="its exposure cannot be set"):
        GentlCamera("camera", {key: v for key, v in first.section.items() if key != "backend"}).open()


def test_a_camera_that_has_a_driver_of_its_own_is_not_listed_again(
    computer: Computer, makers: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (makers / "pylon.cti").touch()
    computer.plug_camera("21734321")
    both = [ListedCamera(serial, "Basler", "acA5472-17um", "U3V") for serial in ("21734321", "7")]
    monkeypatch.setattr(listing, "listed_cameras", lambda path: both)
    assert [(d.serial, d.section["backend"]) for d in discovery.find_devices().devices] == [
        ("21734321", "basler"),
        ("7", "gentl"),
    ]


def test_a_file_that_is_no_producer_and_a_folder_without_one_are_said(
    computer: Computer, makers: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (makers / "vendor.cti").touch()
    (tmp_path / "empty").mkdir()
    monkeypatch.setenv("GENICAM_GENTL64_PATH", f"{makers}{os.pathsep}{tmp_path / 'empty'}")
    found = discovery.find_devices()
    assert found.devices == []
    wrong, empty = found.missing
    assert wrong.startswith(f"cameras of the GenTL producer {makers / 'vendor.cti'} are not listed: ")
    assert "cannot be loaded as a GenTL producer" in wrong
    assert "empty, which holds no producer" in empty
