"""What is plugged in: cameras through pylon, projectors over USB-HID, stages on serial ports."""

from __future__ import annotations

from fpplab.devices import DeviceInfo
from fpplab.errors import DeviceError

DLP4500_VENDOR, DLP4500_PRODUCT = 0x0451, 0x6401
"""USB identity of the DLPC350, the LightCrafter 4500's controller."""


def find() -> list[DeviceInfo]:
    """Every camera, projector and possible stage that this computer sees.

    Raises `DeviceError` naming the library that is missing.
    """
    return [*cameras(), *projectors(), *stages()]


def cameras() -> list[DeviceInfo]:
    """Basler cameras, the SDK's emulated ones among them."""
    try:
        from pypylon import pylon
    except ImportError as error:
        raise DeviceError("camera", "devices", f"pylon does not load ({error})", "install pypylon") from error
    found = pylon.TlFactory.GetInstance().EnumerateDevices()
    return [DeviceInfo("camera", d.GetModelName(), d.GetSerialNumber(), d.GetDeviceClass()) for d in found]


def projectors() -> list[DeviceInfo]:
    """LightCrafters 4500 on USB; the controller shows two interfaces, of which one takes commands."""
    try:
        import hid
    except ImportError as error:
        raise DeviceError(
            "projector", "devices", f"hidapi does not load ({error})", "install the package libusb-1.0-0"
        ) from error
    found = hid.enumerate(DLP4500_VENDOR, DLP4500_PRODUCT)
    return [
        DeviceInfo(
            "projector",
            d["product_string"] or "DLPC350",
            d["serial_number"] or "",
            f"USB {d['path'].decode()}",
        )
        for d in found
        if d["interface_number"] in (-1, 0)
    ]


def stages() -> list[DeviceInfo]:
    """Serial ports that a motion controller may sit on; nothing is sent to them."""
    from serial.tools import list_ports

    return [
        DeviceInfo("stage", p.description, p.serial_number or "", f"serial {p.device}")
        for p in list_ports.comports()
        if p.hwid != "n/a"  # a port of the mainboard with nothing behind it
    ]
