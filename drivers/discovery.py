"""What is plugged in: cameras by pylon, projectors by USB-HID, stages on serial ports; and what is missing.

Nothing is sent to a device. USB itself is asked through pyusb: how fast each device is connected, and whether
one is there that its own library does not show. docs/hardware.md says how to give permissions.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fpplab.devices import DeviceInfo
from fpplab.devices.discovery import FoundDevices

DLP4500_VENDOR, DLP4500_PRODUCT = 0x0451, 0x6401
"""USB identity of the DLPC350, the LightCrafter 4500's controller."""
BASLER_VENDOR = 0x2676
SERIAL_ADAPTERS = {
    (0x2341, 0x0043): "Arduino Uno",
    (0x2341, 0x0042): "Arduino Mega",
    (0x1A86, 0x7523): "CH340",
    (0x0403, 0x6001): "FTDI FT232",
    (0x0403, 0x6015): "FTDI FT230X",
    (0x10C4, 0xEA60): "CP210x",
}
"""USB identities behind which GRBL is usually found."""
SPEEDS = {
    1: "USB 1, 1.5 Mbit/s",
    2: "USB 1, 12 Mbit/s",
    3: "USB 2, 480 Mbit/s",
    4: "USB 3, 5 Gbit/s",
    5: "USB 3, 10 Gbit/s",
}
"""By libusb's number."""
USB_3 = 4
RULES = "copy the udev rules of docs/hardware.md, and plug it in anew"


@dataclass(frozen=True)
class UsbDevice:
    """One device on USB; `speed` is libusb's number, None where the system does not tell."""

    vendor: int
    product: int
    serial: str
    location: str
    speed: int | None
    is_accessible: bool

    @property
    def ids(self) -> tuple[int, int]:
        """Vendor and product."""
        return self.vendor, self.product

    @property
    def label(self) -> str:
        """Its serial number, or where it is plugged in."""
        return self.serial or f"at {self.location}"


def find_devices() -> FoundDevices:
    """Every camera, projector and possible stage that this computer sees, and what hides others."""
    usb, missing = usb_devices()
    found = FoundDevices([], missing)
    for kind, search in (("cameras", cameras), ("projectors", projectors), ("stages", stages)):
        try:
            part = search(usb)
        except ImportError as error:
            found.missing.append(
                f"{kind} are not looked for: {error.name or error} does not load; install it"
            )
            continue
        found.devices.extend(part.devices)
        found.missing.extend(part.missing)
    return found


def usb_devices() -> tuple[list[UsbDevice], list[str]]:
    """All that is on USB, or the reason why it cannot be listed."""
    try:
        import usb.core
    except ImportError:
        return [], ["USB speeds are unknown: pyusb does not load; install it"]
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
        return ""  # it may not be opened, or has none


def _may_use(node: Path) -> bool:
    return not node.exists() or os.access(node, os.R_OK | os.W_OK)


def cameras(usb: Iterable[UsbDevice]) -> FoundDevices:
    """Basler cameras, the SDK's emulated ones among them."""
    from pypylon import pylon

    seen = pylon.TlFactory.GetInstance().EnumerateDevices()
    plugged = [device for device in usb if device.vendor == BASLER_VENDOR]
    speeds = {device.serial: device.speed for device in plugged if device.serial}
    found = FoundDevices([], [])
    for camera in seen:
        link = _link(camera.GetDeviceClass(), speeds.get(camera.GetSerialNumber()))
        found.devices.append(DeviceInfo("camera", camera.GetModelName(), camera.GetSerialNumber(), link))
    serials = {device.serial for device in found.devices}
    for device in plugged:
        if not device.is_accessible:
            found.missing.append(f"camera {device.label}: this user may not open it; {RULES}")
        elif device.serial not in serials:
            found.missing.append(f"camera {device.label}: pylon does not show it; install pylon's USB driver")
        if device.speed is not None and device.speed < USB_3:
            found.missing.append(
                f"camera {device.label}: connected by {SPEEDS.get(device.speed, 'an unknown speed')}; "
                "use a USB 3 port and cable, or frames will be lost"
            )
    return found


def projectors(usb: Iterable[UsbDevice]) -> FoundDevices:
    """LightCrafters 4500 on USB; the controller shows two interfaces, of which one takes commands."""
    import hid

    plugged = [device for device in usb if device.ids == (DLP4500_VENDOR, DLP4500_PRODUCT)]
    found = FoundDevices([], [])
    for one in hid.enumerate(DLP4500_VENDOR, DLP4500_PRODUCT):
        if one["interface_number"] in (-1, 0):
            serial = one["serial_number"] or ""
            speed = next((d.speed for d in plugged if d.serial == serial or len(plugged) == 1), None)
            link = _link(f"USB {one['path'].decode()}", speed)
            found.devices.append(DeviceInfo("projector", one["product_string"] or "DLPC350", serial, link))
    for device in plugged:
        if not device.is_accessible:
            found.missing.append(f"projector {device.label}: this user may not open it; {RULES}")
    if len(plugged) > len(found.devices):
        found.missing.append(
            "a projector is on USB, but not as the HID device it should be: unplug it and plug it in"
        )
    return found


def stages(usb: Iterable[UsbDevice]) -> FoundDevices:
    """Serial ports that a motion controller may sit on."""
    from serial.tools import list_ports

    ports = [
        port for port in list_ports.comports() if port.hwid != "n/a"
    ]  # nothing behind it, on the mainboard
    found = FoundDevices([], [])
    for port in ports:
        ids = "" if port.vid is None else f" (USB {port.vid:04x}:{port.pid:04x})"
        link = f"serial {port.device}{ids}"
        found.devices.append(DeviceInfo("stage", port.description, port.serial_number or "", link))
        if not _may_use(Path(port.device)):
            found.missing.append(
                f"stage on {port.device}: this user may not open it; add yourself to its group "
                "(sudo usermod -aG dialout $USER), and log in anew"
            )
    served = {(port.vid, port.pid) for port in ports}
    for device in usb:
        if device.ids in SERIAL_ADAPTERS and device.ids not in served:
            name = SERIAL_ADAPTERS[device.ids]
            found.missing.append(
                f"stage {device.label}: {name} is on USB without a serial port; install its driver"
            )
    return found


def _link(how: str, speed: int | None) -> str:
    return f"{how}, {SPEEDS[speed]}" if speed in SPEEDS else how
