"""A GenTL camera that no producer has: GenICam's own node map, and frames of the reference bench's light.

It is as strict as a real one: a trigger that comes before it is ready, with another selector or from another
source is ignored, and frames are numbered from 1 after each start.
"""

import time
from collections import deque
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from genicam import genapi

from drivers.gentl.nodes import GentlNodeMap
from drivers.gentl.producer import GentlFrame
from fpplab.core.conventions import Image
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern
from tests.conformance.reference import CAMERA_SIZE, ReferenceBench, sensor_image
from tests.drivers.node_camera import HEAD, Node, choice, integer, number

SERIAL = "G-1"
READY_S = 0.01
"""How long it takes to become ready after a start."""


def in_db(node: Node) -> Node:
    return node[0], node[1].replace("</Max>", "</Max><Unit>dB</Unit>")


SFNC: dict[str, Node] = {
    "Width": integer("Width", 8, 8, CAMERA_SIZE[0], 8),
    "Height": integer("Height", 2, 2, CAMERA_SIZE[1], 2),
    "OffsetX": integer("OffsetX", 8, 0, 40, 8),
    "OffsetY": integer("OffsetY", 0, 0, 30, 2),
    "PixelFormat": choice("PixelFormat", "RGB8", "Mono8", "Mono12"),
    "ExposureTime": number("ExposureTime", 5000.0, 20.0, 1e6),
    "ExposureAuto": choice("ExposureAuto", "Continuous", "Off"),
    "Gain": in_db(number("Gain", 3.0, 0.0, 12.0)),
    "BlackLevel": number("BlackLevel", 0.0, 0.0, 255.0),
    "TriggerSelector": choice("TriggerSelector", "AcquisitionStart", "FrameStart"),
    "TriggerMode": choice("TriggerMode", "Off", "On"),
    "TriggerSource": choice("TriggerSource", "Software", "Line1"),
    "TriggerActivation": choice("TriggerActivation", "RisingEdge", "FallingEdge"),
    "AcquisitionStatusSelector": choice("AcquisitionStatusSelector", "ExposureActive", "FrameTriggerWait"),
    "ResultingFrameRate": number("ResultingFrameRate", 1000.0, 0.0, 1e5),
}


class ScriptedEnd:
    """An open camera, in place of `drivers.gentl.producer.GentlEnd`."""

    model, vendor, link, first_number, line = "maker scripted", "maker", "GenTL GEV", 1, "Line1"

    def __init__(self, bench: ReferenceBench, nodes: dict[str, Node] = SFNC) -> None:
        names = "".join(f"<pFeature>{name}</pFeature>" for name in nodes)
        body = "".join(xml for _, xml in nodes.values())
        self._map = genapi.NodeMap()
        self._map.load_xml_from_string(
            f'{HEAD}<Category Name="Root">{names}</Category>{body}</RegisterDescription>'
        )
        self._bench, self._seen = bench, deque[GentlFrame]()
        self.started, self.triggers, self.lost = False, 0, 0
        self.tells_status = True

    def GetNodeMap(self) -> Any:
        return SimpleNamespace(GetNode=self._node)

    def value(self, name: str) -> Any:
        return self._map.get_node(name).value

    def _node(self, name: str) -> Any:
        always = {"IsValid": lambda: True, "IsWritable": lambda: True, "IsReadable": lambda: True}
        if name == "TriggerSoftware":
            return SimpleNamespace(**always, Execute=lambda: self.trigger("Software", self._bench.on_show))
        if name == "AcquisitionStatus":
            return SimpleNamespace(**always, GetValue=self._is_ready)
        if name == "AcquisitionStatusSelector" and not self.tells_status:
            return GentlNodeMap(self._map).GetNode("Nothing")
        return GentlNodeMap(self._map).GetNode(name)

    def _is_ready(self) -> bool:
        return self.started and time.monotonic() >= self._ready_s

    def trigger(self, source: str, pattern: Pattern | None) -> None:
        """Expose, if this is what the camera waits for."""
        if not self._waits_for(source) or not self._is_ready():
            self.lost += 1
            return
        self.triggers += 1
        image = self._exposed(pattern)
        left, top, width, height = (self.value(n) for n in ("OffsetX", "OffsetY", "Width", "Height"))
        image = image[top : top + height, left : left + width].copy()
        self._seen.append(GentlFrame(image, self.triggers, time.monotonic()))

    def _waits_for(self, source: str) -> bool:
        names = ("TriggerSelector", "TriggerMode", "TriggerSource")
        return tuple(self.value(name) for name in names) == ("FrameStart", "On", source)

    def _exposed(self, pattern: Pattern | None) -> Image:
        bits = int("".join(filter(str.isdigit, self.value("PixelFormat"))))
        return sensor_image(
            self._bench, pattern, CameraSettings(self.value("ExposureTime") / 1e6, self._gain_db(), bits)
        )

    def _gain_db(self) -> float:
        return float(self.value("Gain"))

    def start(self, frames: int) -> None:
        assert not self.started, "it was started twice"
        self._bench.pulses.clear()
        self.started, self.triggers, self._ready_s = True, 0, time.monotonic() + READY_S

    def fetch(self, timeout_s: float) -> GentlFrame | None:
        while self._bench.pulses:
            self.trigger(self.line, self._bench.pulses.popleft())
        while self._bench.frames_to_lose and self._seen:
            self._bench.frames_to_lose -= 1
            self._seen.popleft()
        if not self._seen:
            time.sleep(timeout_s)
            return None
        return self._seen.popleft()

    def stop(self) -> None:
        self.started = False
        self._seen.clear()

    def close(self) -> None:
        assert not self.started, "it was not stopped"


class ScriptedProducer:
    """In place of `drivers.gentl.producer.GentlProducer`."""

    def __init__(self, end: ScriptedEnd) -> None:
        self.end, self.connected = end, [SERIAL]

    def cameras(self) -> dict[str, Any]:
        return dict.fromkeys(self.connected)

    def attach(self, info: Any) -> ScriptedEnd:
        return self.end

    def close(self) -> None: ...


class GentlBench(ReferenceBench):
    """The light of the reference bench on the sensor of a scripted camera."""

    def gentl(self, path: Path) -> ScriptedProducer:
        return ScriptedProducer(ScriptedEnd(self))
