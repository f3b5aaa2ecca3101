"""Discovery of what the computer itself offers: displays, V4L2 cameras, and GenTL producers."""

import os
import re
from pathlib import Path

from drivers.dlp4500.sequence import SIZE as LIGHTCRAFTER
from fpplab.core.errors import DeviceError
from fpplab.devices.discovery import FoundDevice, FoundDevices

VIDEO_CLASS, VIDEO_NODES = Path("/sys/class/video4linux"), Path("/dev")
"""Where Linux lists video devices, and their nodes."""
CONNECTORS = Path("/sys/class/drm")
"""Where Linux lists the connectors of displays, and their modes, the display's own first."""
DESKTOP_SCALES = (1.25, 1.5, 1.75, 2.0, 2.25, 2.5, 3.0)
"""Factors that the settings of desktops offer."""
GENTL_DRIVER = "gentl"  # driver of their cameras, as rig files name it
PRODUCER_PATH = "GENICAM_GENTL64_PATH"  # environment variable that lists the folders of GenTL producers


def displays() -> FoundDevices:
    """List the displays of this computer, which a projector may be."""
    from drivers.display.window import connected_displays

    try:
        listed = connected_displays()
    except DeviceError as error:
        return FoundDevices([], [f"displays are not looked for: {error.found}; {error.remedy}"])
    result = FoundDevices([], [])
    for display in listed:
        section = {
            "backend": "display",
            "display": display.index,
            "size": list(display.size),
            "curve": "srgb",
        }
        link = "{} x {}, {} Hz".format(*display.size, display.refresh_hz)
        if display.is_main:
            link += ", the main display"
        elif display.size == LIGHTCRAFTER:
            link += ", as the video port of a LightCrafter 4500"
        model = f"display {display.index} '{display.name}'"
        if scale := desktop_scale(display.size):
            section = {}
            link += f", scaled by {scale:g}"
            result.missing.append(
                f"projector on {model}: the desktop scales it by {scale:g}, so {display.size[0]} x "
                f"{display.size[1]} are not its pixels; set its scaling to 100 %, and list it again"
            )
        result.devices.append(
            FoundDevice("projector", model, "", link, section, "rig_display.yaml", not display.is_main)
        )
    return result


def desktop_scale(size: tuple[int, int]) -> float | None:
    """Tell by which factor a desktop seems to enlarge a display (HiDPI, Wayland): None where it does not.

    SDL is then told of a size that no connector has, and that is such a part of one's own. It is found on
    Linux alone; elsewhere opening the display notices it.
    """
    modes = [
        [tuple(map(int, mode.split("x"))) for mode in re.findall(r"\d+x\d+", _text(entry / "modes"))]
        for entry in CONNECTORS.glob("card*-*")
        if _text(entry / "status") == "connected"
    ]
    if any(size in of_connector for of_connector in modes):
        return None
    for native in (of_connector[0] for of_connector in modes if of_connector):
        for scale in DESKTOP_SCALES:
            if all(abs(scale * n - whole) <= scale for n, whole in zip(size, native, strict=True)):
                return scale
    return None


def video_cameras() -> FoundDevices:
    """List the cameras that Linux offers by V4L2, such as webcams and other UVC cameras."""
    result = FoundDevices([], [])
    for entry in sorted(VIDEO_CLASS.glob("video*"), key=lambda e: int(e.name.removeprefix("video") or 0)):
        if _text(entry / "index") not in ("0", ""):
            continue  # a further node of the same camera: metadata
        node = VIDEO_NODES / entry.name
        section = {"backend": "video_camera", "device": str(node)}
        result.devices.append(
            FoundDevice("camera", _text(entry / "name"), "", f"V4L2 {node}", section, "rig_webcam.yaml")
        )
        if not os.access(node, os.R_OK | os.W_OK):
            result.missing.append(
                f"camera on {node}: this user may not open it; add yourself to its group "
                "(sudo usermod -aG video $USER), and log in again"
            )
    return result


def producers() -> FoundDevices:
    """List the cameras of the GenTL producers that `GENICAM_GENTL64_PATH` names."""
    result = FoundDevices([], [])
    for name in filter(None, os.environ.get(PRODUCER_PATH, "").split(os.pathsep)):
        files = sorted(Path(name).glob("*.cti"))
        for file in files:
            _add_cameras_of(file.absolute(), result)
        if not files:
            result.missing.append(
                f"{PRODUCER_PATH} names {name}, which holds no producer (*.cti); correct it, or install the "
                "camera maker's software again"
            )
    return result


def _add_cameras_of(producer: Path, result: FoundDevices) -> None:
    from drivers.gentl.listing import listed_cameras

    listed = listed_cameras(producer)
    if isinstance(listed, str):
        result.missing.append(f"cameras of the GenTL producer {producer} are not listed: {listed}")
        return
    for camera in listed:
        model = " ".join(filter(None, (camera.vendor, camera.model)))
        section = {"backend": GENTL_DRIVER, "producer": str(producer), "serial": camera.serial}
        link = f"GenTL {camera.layer}, {producer.name}"
        result.devices.append(FoundDevice("camera", model, camera.serial, link, section, "rig_gentl.yaml"))


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8").strip()
    except OSError:
        return ""
