"""Discovery of what the computer itself offers: displays, V4L2 cameras, and GenTL producers."""

from __future__ import annotations

import os
from pathlib import Path

from drivers.dlp4500.sequence import SIZE as LIGHTCRAFTER
from fpplab.core.errors import DeviceError
from fpplab.devices.discovery import FoundDevice, FoundDevices

VIDEO_CLASS, VIDEO_NODES = Path("/sys/class/video4linux"), Path("/dev")
"""Where Linux lists video devices, and their nodes."""
GENTL_DRIVER = "gentl"
"""Driver of their cameras, as rig files name it."""
PRODUCER_PATH = "GENICAM_GENTL64_PATH"
"""Environment variable that lists the folders of GenTL producers."""


def displays() -> FoundDevices:
    """List the displays of this computer, which a projector may be."""
    from drivers.display.window import connected_displays

    try:
        listed = connected_displays()
    except DeviceError as error:
        return FoundDevices([], [f"displays are not looked for: {error.found}; {error.remedy}"])
    found = FoundDevices([], [])
    for one in listed:
        section = {
            "backend": "display",
            "display": one.index,
            "size": list(one.size),
            "curve": "srgb",
        }
        link = "{} x {}, {} Hz".format(*one.size, one.refresh_hz)
        if one.is_main:
            link += ", the main display"
        elif one.size == LIGHTCRAFTER:
            link += ", as the video port of a LightCrafter 4500"
        model = f"display {one.index} '{one.name}'"
        found.devices.append(
            FoundDevice("projector", model, "", link, section, "rig_display.yaml", not one.is_main)
        )
    return found


def video_cameras() -> FoundDevices:
    """List the cameras that Linux offers by V4L2, such as webcams and other UVC cameras."""
    found = FoundDevices([], [])
    for entry in sorted(VIDEO_CLASS.glob("video*"), key=lambda e: int(e.name.removeprefix("video") or 0)):
        if _text(entry / "index") not in ("0", ""):
            continue  # a further node of the same camera: metadata
        node = VIDEO_NODES / entry.name
        section = {"backend": "video_camera", "device": str(node)}
        found.devices.append(
            FoundDevice("camera", _text(entry / "name"), "", f"V4L2 {node}", section, "rig_webcam.yaml")
        )
        if not os.access(node, os.R_OK | os.W_OK):
            found.missing.append(
                f"camera on {node}: this user may not open it; add yourself to its group "
                "(sudo usermod -aG video $USER), and log in again"
            )
    return found


def producers() -> FoundDevices:
    """List the cameras of the GenTL producers that `GENICAM_GENTL64_PATH` names."""
    found = FoundDevices([], [])
    for name in filter(None, os.environ.get(PRODUCER_PATH, "").split(os.pathsep)):
        files = sorted(Path(name).glob("*.cti"))
        for file in files:
            _add_cameras_of(file.absolute(), found)
        if not files:
            found.missing.append(
                f"{PRODUCER_PATH} names {name}, which holds no producer (*.cti); correct it, or install the "
                "camera maker's software again"
            )
    return found


def _add_cameras_of(producer: Path, found: FoundDevices) -> None:
    from drivers.gentl.listing import listed_cameras

    listed = listed_cameras(producer)
    if isinstance(listed, str):
        found.missing.append(f"cameras of the GenTL producer {producer} are not listed: {listed}")
        return
    for one in listed:
        model = " ".join(filter(None, (one.vendor, one.model)))
        section = {"backend": GENTL_DRIVER, "producer": str(producer), "serial": one.serial}
        link = f"GenTL {one.layer}, {producer.name}"
        found.devices.append(FoundDevice("camera", model, one.serial, link, section, "rig_gentl.yaml"))


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8").strip()
    except OSError:
        return ""
