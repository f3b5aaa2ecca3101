"""Discovery of connected devices: through pylon, USB HID and serial ports, and what the computer offers.

Nothing is sent to a device. USB itself is queried through pyusb: the speed of each connection, and whether a
device is present that its own library does not list. docs/hardware.md explains how to grant permissions.
"""

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from drivers import computer_discovery, computer_settings
from drivers.dlp4500.sequence import SIZE as LIGHTCRAFTER
from drivers.dlp4500.transport import PRODUCT, VENDOR, command_interfaces
from fpplab.core.extras import MissingExtraError, missing_extra
from fpplab.devices.discovery import FoundDevice, FoundDevices

LIGHTCRAFTER_DRIVER = "dlp4500"  # its driver, as rig files name it
BASLER_VENDOR = 0x2676  # USB vendor id of Basler (the USB-IF's list)
SERIAL_ADAPTERS = {
    (0x2341, 0x0043): "Arduino Uno",
    (0x2341, 0x0042): "Arduino Mega",
    (0x1A86, 0x7523): "CH340",
    (0x1A86, 0x5523): "CH341",
    (0x0403, 0x6001): "FTDI FT232",
    (0x0403, 0x6015): "FTDI FT230X",
    (0x10C4, 0xEA60): "CP210x",
}
"""USB identities (vendor, product) of serial adapters that GRBL controllers usually have."""
SPEEDS = {
    1: "USB 1, 1.5 Mbit/s",
    2: "USB 1, 12 Mbit/s",
    3: "USB 2, 480 Mbit/s",
    4: "USB 3, 5 Gbit/s",
    5: "USB 3, 10 Gbit/s",
}
"""Descriptions of libusb's speed numbers (`enum libusb_speed`)."""
USB_3 = 4  # libusb's least speed number of USB 3
BENCH = "rig_bench.yaml"  # rig file that comes with fpplab, of a bench of these devices
RULES = "copy the udev rules of docs/hardware.md, and plug it in again"


@dataclass(frozen=True)
class UsbDevice:
    """One device on USB."""

    vendor: int  # USB vendor id
    product: int  # USB product id
    serial: str  # serial number; empty where the device has none or may not be opened
    location: str  # bus and address, such as "USB 1-4"
    speed: int | None  # libusb's speed number, see `SPEEDS`; None where the system does not report it
    is_accessible: bool  # whether this user may open the device node

    @property
    def ids(self) -> tuple[int, int]:
        return self.vendor, self.product

    @property
    def label(self) -> str:
        """Serial number, or the location of a device without one."""
        return self.serial or f"at {self.location}"


def find_devices() -> FoundDevices:
    """List every camera, projector and possible stage that this computer sees."""
    # A library that does not load is reported as missing; the other kinds of device are listed nevertheless.
    usb, missing = usb_devices()
    result = FoundDevices([], missing)
    searches: dict[str, Callable[[], FoundDevices]] = {
        "cameras": lambda: cameras(usb),
        "V4L2 cameras": computer_discovery.video_cameras,
        "GenTL producers": computer_discovery.producers,
        "projectors": lambda: projectors(usb),
        "displays": computer_discovery.displays,
        "stages": lambda: stages(usb),
    }
    for kind, search in searches.items():
        try:
            part = search()
        except (ImportError, MissingExtraError) as error:
            result.missing.append(f"{kind} are not looked for: {_why_not(error)}")
            continue
        result.devices.extend(part.devices)
        result.missing.extend(part.missing)
    result.missing.extend(_settings(usb, result.devices))
    listed = [device for device in result.devices if not _is_again(device, result.devices)]
    return FoundDevices([_with_video_port(device, listed) for device in listed], result.missing)


def _settings(usb: Iterable[UsbDevice], devices: Iterable[FoundDevice]) -> list[str]:
    """Describe what the computer's settings do to the cameras."""
    on_usb_3 = any(d.vendor == BASLER_VENDOR and (d.speed or 0) >= USB_3 for d in usb)
    on_network = any("GigE" in d.link or "GenTL GEV" in d.link for d in devices)
    sentences = [
        computer_settings.usb_memory() if on_usb_3 else None,
        computer_settings.filtered_packets(),
        computer_settings.full_sockets() if on_network else None,
    ]
    return [sentence for sentence in sentences if sentence is not None]


def _why_not(error: ImportError | MissingExtraError) -> str:
    """What keeps a library from being loaded, and what to do."""
    if isinstance(error, MissingExtraError):
        return str(error)
    return str(missing_extra(error) or f"{error.name or error} does not load; install it")


def _is_again(device: FoundDevice, all_found: Iterable[FoundDevice]) -> bool:
    """Whether a camera of a GenTL producer is listed with a driver of its own as well."""
    others = [d for d in all_found if d.section.get("backend") != computer_discovery.GENTL_DRIVER]
    return device not in others and device.serial in {d.serial for d in others if d.kind == "camera"}


def _with_video_port(device: FoundDevice, all_found: Iterable[FoundDevice]) -> FoundDevice:
    """A LightCrafter that takes its patterns from the display that its video port is, if there is one."""
    if device.section.get("backend") != LIGHTCRAFTER_DRIVER:
        return device
    size = list(LIGHTCRAFTER)
    ports = [d.section["display"] for d in all_found if d.is_certain and d.section.get("size") == size]
    if len(ports) != 1:
        return device
    kept_keys = {key: value for key, value in device.section.items() if key != "flash"}
    return replace(device, section={**kept_keys, "video": {"display": ports[0]}})


def usb_devices() -> tuple[list[UsbDevice], list[str]]:
    try:
        import usb.core
    except ImportError as error:
        return [], [f"USB speeds are unknown: {_why_not(error)}"]
    try:
        return [_usb_device(device) for device in usb.core.find(find_all=True)], []
    except usb.core.NoBackendError:
        return [], ["USB speeds are unknown: pyusb finds no libusb; install libusb-1.0-0"]
    except usb.core.USBError as error:
        return [], [f"USB speeds are unknown: libusb fails ({error})"]


def _usb_device(device: Any) -> UsbDevice:
    node = Path(f"/dev/bus/usb/{device.bus or 0:03d}/{device.address or 0:03d}")
    return UsbDevice(
        device.idVendor,
        device.idProduct,
        _serial(device),
        f"USB {device.bus}-{device.address}",
        getattr(device, "speed", None),
        _may_use(node),
    )


def _serial(device: Any) -> str:
    import usb.core

    try:
        return device.serial_number or ""
    except (ValueError, NotImplementedError, usb.core.USBError):
        return ""  # no permission to open it, or no serial number


def _may_use(node: Path) -> bool:
    return not node.exists() or os.access(node, os.R_OK | os.W_OK)


def cameras(usb: Iterable[UsbDevice]) -> FoundDevices:
    """List Basler cameras, including pylon's emulated ones."""
    from pypylon import pylon

    listed = pylon.TlFactory.GetInstance().EnumerateDevices()
    plugged = [device for device in usb if device.vendor == BASLER_VENDOR]
    speeds = {device.serial: device.speed for device in plugged if device.serial}
    result = FoundDevices([], [])
    for camera in listed:
        link = _link(camera.GetDeviceClass(), speeds.get(camera.GetSerialNumber()))
        model, serial = camera.GetModelName(), camera.GetSerialNumber()
        section = {"backend": "basler", "serial": serial}
        result.devices.append(FoundDevice("camera", model, serial, link, section, BENCH))
    serials = {device.serial for device in result.devices}
    for device in plugged:
        if not device.is_accessible:
            result.missing.append(f"camera {device.label}: this user may not open it; {RULES}")
        elif device.serial not in serials:
            result.missing.append(
                f"camera {device.label}: pylon does not show it; install pylon's USB driver"
            )
        if device.speed is not None and device.speed < USB_3:
            result.missing.append(
                f"camera {device.label}: connected by {SPEEDS.get(device.speed, 'an unknown speed')}; "
                "use a USB 3 port and cable, or frames will be lost"
            )
    return result


def projectors(usb: Iterable[UsbDevice]) -> FoundDevices:
    import hid

    plugged = [device for device in usb if device.ids == (VENDOR, PRODUCT)]
    result = FoundDevices([], [])
    for interface in command_interfaces(hid):
        serial = interface["serial_number"] or ""
        speed = next((d.speed for d in plugged if d.serial == serial or len(plugged) == 1), None)
        link = _link(f"USB {interface['path'].decode()}", speed)
        serial_key = {"serial": serial} if serial else {}
        section = {"backend": LIGHTCRAFTER_DRIVER, "flash": "patterns.yaml", **serial_key}
        model = interface["product_string"] or "DLPC350"
        result.devices.append(FoundDevice("projector", model, serial, link, section, BENCH))
    for device in plugged:
        if not device.is_accessible:
            result.missing.append(f"projector {device.label}: this user may not open it; {RULES}")
    if len(plugged) > len(result.devices):
        result.missing.append(
            "a projector is on USB, but without its HID interface: unplug it and plug it in again"
        )
    return result


def stages(usb: Iterable[UsbDevice]) -> FoundDevices:
    """List serial ports that a motion controller may be connected to."""
    # Ports without hardware behind them are left out. Whether a GRBL controller answers is not tested.
    from serial.tools import list_ports

    # "n/a" is a port of the mainboard without hardware behind it
    ports = [port for port in list_ports.comports() if port.hwid != "n/a"]
    result = FoundDevices([], [])
    for port in ports:
        ids = "" if port.vid is None else f" (USB {port.vid:04x}:{port.pid:04x})"
        link = f"serial {port.device}{ids}"
        section = {"backend": "grbl", "port": port.device}
        result.devices.append(
            FoundDevice("stage", port.description, port.serial_number or "", link, section, BENCH, False)
        )
        if not _may_use(Path(port.device)):
            result.missing.append(
                f"stage on {port.device}: this user may not open it; add yourself to its group "
                "(sudo usermod -aG dialout $USER), and log in again"
            )
    served = {(port.vid, port.pid) for port in ports}
    for device in usb:
        if device.ids in SERIAL_ADAPTERS and device.ids not in served:
            name = SERIAL_ADAPTERS[device.ids]
            remedy = "install its driver"
            if computer_settings.claims_of_brltty(*device.ids):
                remedy = "brltty, for braille displays, claims it: sudo apt-get remove brltty, and replug it"
            result.missing.append(f"stage {device.label}: {name} is on USB without a serial port; {remedy}")
    return result


def _link(connection: str, speed: int | None) -> str:
    return f"{connection}, {SPEEDS[speed]}" if speed in SPEEDS else connection
