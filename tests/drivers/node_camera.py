"""A camera of SFNC 2 that pylon's emulator is not: GenICam's own node map of its features, scripted frames.

The node map is real (GenApi reads it from XML, and refuses what its ranges refuse); the frames are those of a
test. The names are those of pylon's documentation for ace USB cameras, the values a test's own.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pypylon import genicam, pylon

SERIAL = "21734321"

HEAD = """<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="ace" VendorName="test" StandardNameSpace="None" SchemaMajorVersion="1"
 SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0"
 ToolTip="" ProductGuid="11111111-1111-1111-1111-111111111111"
 VersionGuid="11111111-1111-1111-1111-111111111112" xmlns="http://www.genicam.org/GenApi/Version_1_1"
 xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
 xsi:schemaLocation="http://www.genicam.org/GenApi/Version_1_1
 http://www.genicam.org/GenApi/GenApiSchema_Version_1_1.xsd">
"""

Node = tuple[str, str]
"""Kind of parameter in pylon, and the XML of the node."""


def integer(name: str, value: int, least: int, most: int, step: int = 1) -> Node:
    inside = f"<Value>{value}</Value><Min>{least}</Min><Max>{most}</Max><Inc>{step}</Inc>"
    return "Integer", f'<Integer Name="{name}">{inside}</Integer>'


def number(name: str, value: float, least: float, most: float) -> Node:
    inside = f"<Value>{value}</Value><Min>{least}</Min><Max>{most}</Max>"
    return "Float", f'<Float Name="{name}">{inside}</Float>'


def fixed(name: str, value: int) -> Node:
    """Make an integer that can be read only."""
    return (
        "Integer",
        f'<Integer Name="{name}"><ImposedAccessMode>RO</ImposedAccessMode><Value>{value}</Value></Integer>',
    )


def switch(name: str, on: bool) -> Node:
    inside = f"<Value>{int(on)}</Value><OnValue>1</OnValue><OffValue>0</OffValue>"
    return "Boolean", f'<Boolean Name="{name}">{inside}</Boolean>'


def choice(name: str, *names: str) -> Node:
    entries = "".join(
        f'<EnumEntry Name="{entry}"><Value>{i}</Value></EnumEntry>' for i, entry in enumerate(names)
    )
    return "Enum", f'<Enumeration Name="{name}">{entries}<Value>0</Value></Enumeration>'


ACE: dict[str, Node] = {
    "Width": integer("Width", 64, 16, 64, 16),
    "Height": integer("Height", 8, 2, 8, 2),
    "OffsetX": integer("OffsetX", 0, 0, 48, 16),
    "OffsetY": integer("OffsetY", 0, 0, 6, 2),
    "PayloadSize": integer("PayloadSize", 512, 0, 1 << 30),
    "PixelFormat": choice("PixelFormat", "Mono8", "Mono12", "Mono12p"),
    "ExposureTime": number("ExposureTime", 5000.0, 19.0, 1e7),
    "Gain": number("Gain", 0.0, 0.0, 27.0),
    "BlackLevel": number("BlackLevel", 0.0, 0.0, 255.0),
    "TriggerSelector": choice("TriggerSelector", "FrameStart", "FrameBurstStart"),
    "TriggerMode": choice("TriggerMode", "Off", "On"),
    "TriggerSource": choice("TriggerSource", "Software", "Line1", "Line3"),
    "TriggerActivation": choice("TriggerActivation", "RisingEdge", "FallingEdge"),
    "TriggerDelay": number("TriggerDelay", 0.0, 0.0, 1e6),
    "ShutterMode": choice("ShutterMode", "Rolling", "GlobalResetRelease"),
    "SensorReadoutTime": number("SensorReadoutTime", 54321.0, 0.0, 1e7),
}


@dataclass
class Result:
    """A grab result: the pixels as they lie in the buffer, and what came with them."""

    raw: NDArray[Any]
    width: int
    height: int
    pixel_type: int
    block_id: int
    ticks: int = 0

    def IsValid(self) -> bool:
        return True

    def GrabSucceeded(self) -> bool:
        return True

    def GetBlockID(self) -> int:
        return self.block_id

    def GetTimeStamp(self) -> int:
        return self.ticks

    def GetPixelType(self) -> int:
        return self.pixel_type

    def GetWidth(self) -> int:
        return self.width

    def GetHeight(self) -> int:
        return self.height

    def GetPaddingX(self) -> int:
        is_packed = self.pixel_type == pylon.PixelType_Mono12p
        row_bytes = 3 * self.width // 2 if is_packed else self.width * self.raw.itemsize
        return self.raw.nbytes // self.height - row_bytes

    def GetImageMemoryView(self) -> memoryview:
        return memoryview(self.raw.reshape(-1).view(np.uint8))


class NodeMap:
    """Parameters over GenApi's nodes, as pylon's own node map hands them out."""

    def __init__(self, nodes: dict[str, Node]) -> None:
        names = "".join(f"<pFeature>{name}</pFeature>" for name in nodes)
        body = "".join(xml for _, xml in nodes.values())
        self._map = genicam.CNodeMapRef()
        self._map._LoadXMLFromString(
            f'{HEAD}<Category Name="Root">{names}</Category>{body}</RegisterDescription>'
        )
        self._kinds = {name: kind for name, (kind, _) in nodes.items()}

    def GetNode(self, name: str) -> Any:
        kind = getattr(pylon, f"{self._kinds.get(name, 'Integer')}Parameter")
        return kind(self._map.GetNode(name)) if name in self._kinds else kind()


class NodeCamera:
    """An `InstantCamera` and the `pylon` that creates it, in one class."""

    def __init__(
        self, nodes: dict[str, Node] = ACE, device_class: str = "BaslerUsb", model: str = "ace"
    ) -> None:
        self.map, self.results = NodeMap(nodes), deque[Result]()
        self.ready_is_known, self.triggers, self.grabbing = True, 0, False
        self.MaxNumBuffer = SimpleNamespace(SetValue=lambda n: None)
        self._class, self._model = device_class, model
        self.link = NodeMap({})

    def cameras(self) -> dict[str, Any]:
        return {SERIAL: None}

    def attach(self, info: Any) -> NodeCamera:
        return self

    def GetNodeMap(self) -> NodeMap:
        return self.map

    def GetDeviceInfo(self) -> Any:
        return SimpleNamespace(
            GetDeviceClass=lambda: self._class,
            GetModelName=lambda: self._model,
            GetSerialNumber=lambda: SERIAL,
        )

    def CanWaitForFrameTriggerReady(self) -> bool:
        return self.ready_is_known

    def WaitForFrameTriggerReady(self, timeout_ms: int, handling: Any) -> bool:
        return True

    def ExecuteSoftwareTrigger(self) -> None:
        self.triggers += 1

    def RetrieveResult(self, timeout_ms: int, handling: Any) -> Result:
        return self.results.popleft()

    def IsCameraDeviceRemoved(self) -> bool:
        return False

    def GetStreamGrabberNodeMap(self) -> NodeMap:
        return self.link

    def IsGrabbing(self) -> bool:
        return self.grabbing

    def StartGrabbing(self, strategy: Any) -> None:
        self.grabbing = True

    def StopGrabbing(self) -> None:
        self.grabbing = False

    def Open(self) -> None: ...

    def Close(self) -> None: ...

    def DestroyDevice(self) -> None: ...
