"""Node maps of six makers, as their public documents list them, found as another program may have left them.

Each is as strict as its documents: a trigger counts only where the selector's own mode and source say so, one
that comes before the frame is read out is ignored, and every feature that alters grey levels does alter them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from drivers.gentl.nodes import GentlNodeMap
from fpplab.core.conventions import Image
from fpplab.patterns.fringes import Pattern
from tests.conformance.gentl_end import SFNC, ScriptedEnd
from tests.conformance.reference import ReferenceBench
from tests.drivers.node_camera import Node, choice, integer, number, switch

READOUT_S = 0.009
SELECTORS = {
    "Gain": "GainSelector",
    "LUTEnable": "LUTSelector",
    "CorrectionMode": "CorrectionSelector",
    "TriggerMode": "TriggerSelector",
    "TriggerSource": "TriggerSelector",
    "TriggerOverlap": "TriggerSelector",
}
"""Features that have a value for each entry of a selector; the node of each is named by both."""


@dataclass(frozen=True)
class MakerCamera:
    """A simulated camera of a maker."""

    vendor: str
    line: str
    trigger: str  # value of TriggerSelector that starts the exposure of a frame
    rate: str  # feature that tells the frame rate at the present settings
    raw: dict[str, tuple[Node, Any]]  # features that alter grey levels, as found, and their neutral values
    nodes: dict[str, Node] = field(default_factory=dict)  # others that differ from SFNC
    rate_is_greatest: bool = False
    gain_is_factor: bool = False
    formats: tuple[str, ...] = ("Mono8", "Mono12")


def switches(*names: str) -> dict[str, tuple[Node, Any]]:
    return {name: (switch(name, True), False) for name in names}


def modes(*names: str) -> dict[str, tuple[Node, Any]]:
    return {name: (choice(name, "On", "Off"), "Off") for name in names}


def overlaps(*entries: str) -> dict[str, Node]:
    return {"TriggerOverlapFrameStart": choice("TriggerOverlapFrameStart", *entries)}


DIGITAL = {"GainSelector": choice("GainSelector", "DigitalAll", "AnalogAll")}
GAMMA = {"Gamma": (number("Gamma", 0.7, 0.2, 4.0), 1.0)}
CAMERAS = {
    "flir": MakerCamera(
        "FLIR",
        "Line0",
        "FrameStart",
        "AcquisitionResultingFrameRate",
        switches(
            "SharpeningEnable", "SharpeningAuto", "DefectCorrectStaticEnable", "BlackLevelClampingEnable"
        )
        | switches("GammaEnable", "IspEnable", "LUTEnableLUT1"),
        overlaps("Off", "ReadOut") | {"LUTSelector": choice("LUTSelector", "LUT1")},
    ),
    "point grey": MakerCamera(
        "Point Grey Research",
        "Line0",
        "FrameStart",
        "AcquisitionFrameRate",
        switches("GammaEnabled", "SharpnessEnabled", "pgrDefectPixelCorrectionEnable")
        | switches("OnBoardColorProcessEnabled", "BlackLevelClampingEnable")
        | {"VideoMode": (choice("VideoMode", "Mode1", "Mode0"), "Mode0")},
        overlaps("Off", "ReadOut"),
        rate_is_greatest=True,
    ),
    "ids": MakerCamera(
        "IDS Imaging Development Systems GmbH",
        "Line0",
        "ExposureStart",
        "AcquisitionFrameRate",
        GAMMA | {"GainDigitalAll": (number("GainDigitalAll", 2.0, 1.0, 8.0), 1.0)},
        DIGITAL
        | {"GainAnalogAll": number("GainAnalogAll", 3.0, 1.0, 16.0)}
        | {"AcquisitionFrameRateTargetEnable": switch("AcquisitionFrameRateTargetEnable", True)},
        rate_is_greatest=True,
        gain_is_factor=True,
    ),
    "allied vision": MakerCamera(
        "Allied Vision",
        "Line0",
        "FrameStart",
        "AcquisitionFrameRate",
        switches("ContrastEnable", "LUTEnable")
        | GAMMA
        | {
            "ConvolutionMode": (choice("ConvolutionMode", "Sharpness", "Off"), "Off"),
            "AdaptiveNoiseSuppressionFactor": (number("AdaptiveNoiseSuppressionFactor", 2.0, 0.0, 3.0), 1.0),
            "Sharpness": (integer("Sharpness", 4, -12, 12), 0),
        }
        | modes("CorrectionModeDefectPixelCorrection", "CorrectionModeFixedPatternNoiseCorrection"),
        {
            "CorrectionSelector": choice(
                "CorrectionSelector", "DefectPixelCorrection", "FixedPatternNoiseCorrection"
            ),
            "SensorShutterMode": choice("SensorShutterMode", "GlobalShutter"),
        },
        rate_is_greatest=True,
    ),
    "hikrobot": MakerCamera(
        "Hikrobot",
        "Line0",
        "FrameStart",
        "ResultingFrameRate",
        switches("SharpnessEnable", "ContrastRatioEnable", "DigitalShiftEnable", "HDREnable", "NUCEnable")
        | switches("GammaEnable", "LUTEnable", "FPNCEnable", "PRNUCEnable"),
        {"TriggerCacheEnable": switch("TriggerCacheEnable", True)},
    ),
    "daheng": MakerCamera(
        "Daheng Imaging",
        "Line0",
        "FrameStart",
        "CurrentAcquisitionFrameRate",
        modes(
            "SharpnessMode", "DeadPixelCorrect", "FlatFieldCorrection", "NoiseReductionMode", "ColorCorrect"
        )
        | switches("GammaEnable", "LUTEnable")
        | {"DigitalShift": (integer("DigitalShift", 2, 0, 4), 0)},
        {"AcquisitionFrameRateMode": choice("AcquisitionFrameRateMode", "On", "Off")},
        formats=("BayerRG8", "BayerRG12"),
    ),
    "jai": MakerCamera(
        "JAI Corporation",
        "Line5",
        "FrameStart",
        "AcquisitionFrameRate",
        {"LUTMode": (choice("LUTMode", "Gamma", "Off"), "Off")}
        | switches("BlemishEnable")
        | modes("ShadingMode", "ColorTransformationRGBMode")
        | {"GainDigitalAll": (number("GainDigitalAll", 2.0, 0.5, 8.0), 1.0)},
        overlaps("Off", "ReadOut")
        | DIGITAL
        | {"GainAnalogAll": number("GainAnalogAll", 1.0, 1.0, 16.0)}
        | {"ExposureModeOption": choice("ExposureModeOption", "Off")},
        rate_is_greatest=True,
        gain_is_factor=True,
    ),
}
TRIGGERS = ("AcquisitionStart", "FrameStart", "ExposureStart")


def nodes_of(camera: MakerCamera) -> dict[str, Node]:
    entries = tuple(e for e in TRIGGERS if e in ("AcquisitionStart", camera.trigger))
    own = {
        "TriggerSelector": choice("TriggerSelector", *entries),
        "PixelFormat": choice("PixelFormat", "RGB8", *camera.formats),
        camera.rate: number(camera.rate, 5.0, 0.1, 1000.0),
        "AcquisitionFrameRateEnable": switch("AcquisitionFrameRateEnable", True),
    }
    for entry in entries:  # a trigger of the whole acquisition was left on
        own[f"TriggerMode{entry}"] = choice(f"TriggerMode{entry}", "On", "Off")
        own[f"TriggerSource{entry}"] = choice(f"TriggerSource{entry}", camera.line, "Software")
    left_out = {
        "TriggerMode",
        "TriggerSource",
        "ResultingFrameRate",
        *(("Gain",) if camera.gain_is_factor else ()),
    }
    standard = {name: node for name, node in SFNC.items() if name not in left_out}
    raw = {name: node for name, (node, _) in camera.raw.items()}
    return standard | raw | own | camera.nodes


class MakerEnd(ScriptedEnd):
    """An open camera of a maker."""

    def __init__(self, bench: ReferenceBench, camera: MakerCamera) -> None:
        super().__init__(bench, nodes_of(camera))
        self.camera, self.vendor, self.model = camera, camera.vendor, f"{camera.vendor} scripted"
        self.tells_status, self.line = False, camera.line

    @property
    def interval_s(self) -> float:
        """Least time from one trigger to the next that the camera takes."""
        exposure_s = self.value("ExposureTime") / 1e6
        name = f"TriggerOverlap{self.camera.trigger}"
        overlapping = self.camera.rate == "ResultingFrameRate" or self.camera.rate.startswith("Current")
        if name in self.camera.nodes:
            overlapping = self.value(name) == "ReadOut"
        return max(exposure_s, READOUT_S) if overlapping else exposure_s + READOUT_S

    def _node(self, name: str) -> Any:
        selector = SELECTORS.get(name)
        if selector is not None and self._has(selector):
            own = f"{name}{self.value(selector)}"
            if self._has(own):
                return GentlNodeMap(self._map).GetNode(own)
        if name == "Gamma" and self._has("GammaEnable") and not self.value("GammaEnable"):
            return GentlNodeMap(self._map).GetNode("Nothing")
        node = super()._node(name)
        if name == self.camera.rate:
            return self._rate()
        if self.started and name in ("Width", "Height", "OffsetX", "OffsetY", "PixelFormat"):
            return SimpleNamespace(
                IsValid=lambda: True,
                IsReadable=lambda: True,
                IsWritable=lambda: False,
                GetValue=node.GetValue,
            )
        return node

    def _rate(self) -> Any:
        """The rate at the present settings: as a value that is read, or as the greatest that can be set."""
        readable = {"IsValid": lambda: True, "IsReadable": lambda: True, "IsWritable": lambda: False}
        if self.camera.rate_is_greatest:
            most = 1.0 / max(self.value("ExposureTime") / 1e6, READOUT_S)
            return SimpleNamespace(**readable, GetMin=lambda: 0.1, GetMax=lambda: most, GetValue=lambda: 5.0)
        return SimpleNamespace(**readable, GetValue=lambda: 1.0 / self.interval_s)

    def _has(self, name: str) -> bool:
        return bool(GentlNodeMap(self._map).GetNode(name).IsValid())

    def _waits_for(self, source: str) -> bool:
        trigger = self.camera.trigger
        idle = trigger == "AcquisitionStart" or self.value("TriggerModeAcquisitionStart") == "Off"
        own = (self.value(f"TriggerMode{trigger}"), self.value(f"TriggerSource{trigger}"))
        return idle and own == ("On", source)

    def _exposed(self, pattern: Pattern | None) -> Image:
        image = super()._exposed(pattern)
        altered = [name for name, (_, neutral) in self.camera.raw.items() if self.value(name) != neutral]
        return image // 2 if altered else image

    def _gain_db(self) -> float:
        if self.camera.gain_is_factor:
            return 20.0 * math.log10(self.value("GainAnalogAll"))
        return float(self.value("Gain"))
