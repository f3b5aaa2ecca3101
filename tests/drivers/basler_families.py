"""Node maps of five Basler cameras, as their public descriptions give them, left as another program may.

Names are those of Basler's parameter reference for each family; ranges of GainRaw, of gain and of sizes are
of the models named. Every feature that makes frames other than the sensor's is found switched on.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from tests.drivers.node_camera import Node, NodeCamera, choice, integer, number, switch

Wrong = dict[str, tuple[Node, Any]]
"""A node as another program left it, and the value that raw frames need."""


def off(name: str, on: str) -> tuple[Node, Any]:
    return choice(name, on, "Off"), "Off"


def enabled(name: str) -> tuple[Node, Any]:
    return switch(name, True), False


def zero(name: str, found: float) -> tuple[Node, Any]:
    return number(name, found, -1.0, 4.0), 0.0


def one(name: str) -> tuple[Node, Any]:
    return integer(name, 2, 1, 4), 1


@dataclass
class Kind:
    """A camera, and what is true of it."""

    model: str
    device_class: str
    nodes: dict[str, Node]
    wrong: Wrong
    gain: str
    factor: Callable[[float], float]
    """By how much its value of `gain` amplifies."""
    exposure: str
    black_level: str
    debouncer: str
    delay: str
    options: dict[str, Any] = field(default_factory=dict)

    def camera(self, **nodes: Node) -> NodeCamera:
        dirty = {name: node for name, (node, _) in self.wrong.items()}
        return NodeCamera({**self.nodes, **dirty, **nodes}, self.device_class, self.model)


def decibel(gain: float) -> float:
    return float(10.0 ** (gain / 20.0))


def sensor(width: int, height: int, step: int, step_y: int, *formats: str) -> dict[str, Node]:
    """The region of interest begins small and off the origin, so that offsets limit it."""
    return {
        "Width": integer("Width", 4 * step, step, width, step),
        "Height": integer("Height", 4 * step_y, step_y, height, step_y),
        "OffsetX": integer("OffsetX", step, 0, width - step, step),
        "OffsetY": integer("OffsetY", step_y, 0, height - step_y, step_y),
        "PayloadSize": integer("PayloadSize", width * height, 0, 1 << 30),
        "PixelFormat": choice("PixelFormat", *formats),
        "TriggerSelector": choice("TriggerSelector", "AcquisitionStart", "FrameStart"),
        "TriggerMode": choice("TriggerMode", "On", "Off"),
        "TriggerSource": choice("TriggerSource", "Software", "Line1", "Line3"),
        "TriggerActivation": choice("TriggerActivation", "FallingEdge", "RisingEdge"),
        "LineSelector": choice("LineSelector", "Line2", "Line1"),
        "LineMode": choice("LineMode", "Output", "Input"),
        "LineInverter": switch("LineInverter", True),
    }


COMMON: Wrong = {
    "AcquisitionMode": (choice("AcquisitionMode", "SingleFrame", "Continuous"), "Continuous"),
    "AcquisitionFrameRateEnable": enabled("AcquisitionFrameRateEnable"),
    "ExposureMode": (choice("ExposureMode", "TriggerWidth", "Timed"), "Timed"),
    "ExposureAuto": off("ExposureAuto", "Continuous"),
    "GainAuto": off("GainAuto", "Once"),
    "LUTEnable": enabled("LUTEnable"),
    "BinningHorizontal": one("BinningHorizontal"),
    "BinningVertical": one("BinningVertical"),
    "DecimationVertical": one("DecimationVertical"),
    "ReverseX": enabled("ReverseX"),
    "ChunkModeActive": enabled("ChunkModeActive"),
}
ETHERNET = {
    "GevSCPSPacketSize": integer("GevSCPSPacketSize", 1500, 220, 16404, 4),
    "GevSCPD": integer("GevSCPD", 0, 0, 50_000_000),
    "GevTimestampTickFrequency": integer("GevTimestampTickFrequency", 125_000_000, 0, 1 << 40),
}


def sfnc_1(gain_raw: Node, black_level_most: int) -> dict[str, Node]:
    return {
        "ExposureTimeAbs": number("ExposureTimeAbs", 35000.0, 28.0, 1e7),
        "GainRaw": gain_raw,
        "GainSelector": choice("GainSelector", "Tap1", "All"),
        "BlackLevelRaw": integer("BlackLevelRaw", 32, 0, black_level_most),
        "BlackLevelSelector": choice("BlackLevelSelector", "Tap1", "All"),
        "TriggerDelayAbs": number("TriggerDelayAbs", 250.0, 0.0, 1e6),
        "LineDebouncerTimeAbs": number("LineDebouncerTimeAbs", 10.0, 0.0, 20e3),
        "ReadoutTimeAbs": number("ReadoutTimeAbs", 39000.0, 0.0, 1e7),
        "ResultingFrameRateAbs": number("ResultingFrameRateAbs", 25.0, 0.0, 1e5),
        **ETHERNET,
    }


def sfnc_2(gain_most: float, resulting: str) -> dict[str, Node]:
    return {
        "ExposureTime": number("ExposureTime", 5000.0, 19.0, 1e7),
        "Gain": number("Gain", 3.0, 0.0, gain_most),
        "GainSelector": choice("GainSelector", "DigitalAll", "All"),
        "BlackLevel": number("BlackLevel", 8.0, 0.0, 255.0),
        "BlackLevelSelector": choice("BlackLevelSelector", "DigitalAll", "All"),
        "TriggerDelay": number("TriggerDelay", 250.0, 0.0, 1e6),
        "LineDebouncerTime": number("LineDebouncerTime", 10.0, 0.0, 20e3),
        "SensorReadoutTime": number("SensorReadoutTime", 14000.0, 0.0, 1e7),
        resulting: number(resulting, 60.0, 0.0, 1e5),
    }


OF_SFNC_1 = {"exposure": "ExposureTimeAbs", "black_level": "BlackLevelRaw"} | {
    "debouncer": "LineDebouncerTimeAbs", "delay": "TriggerDelayAbs", "gain": "GainRaw"
}  # fmt: skip
OF_SFNC_2 = {"exposure": "ExposureTime", "black_level": "BlackLevel"} | {
    "debouncer": "LineDebouncerTime", "delay": "TriggerDelay", "gain": "Gain"
}  # fmt: skip

KINDS = {
    kind.model: kind
    for kind in (
        Kind(
            "acA2040-25gm",
            "BaslerGigE",
            sensor(2048, 2048, 32, 1, "Mono8", "Mono12")
            | sfnc_1(integer("GainRaw", 100, 36, 512), 1023)
            | {"ShutterMode": choice("ShutterMode", "Global")},
            COMMON
            | {
                "ReverseY": enabled("ReverseY"),
                "GammaEnable": enabled("GammaEnable"),
                "DigitalShift": (integer("DigitalShift", 2, 0, 4), 0),
                "SequenceEnable": enabled("SequenceEnable"),
                "StackedZoneImagingEnable": enabled("StackedZoneImagingEnable"),
                "TestImageSelector": off("TestImageSelector", "Testimage1"),
            },
            factor=lambda raw: raw / 32.0,
            **OF_SFNC_1,
        ),
        Kind(
            "acA750-30gm",
            "BaslerGigE",
            sensor(752, 480, 4, 2, "Mono8", "Mono12") | sfnc_1(integer("GainRaw", 100, 0, 1023), 63),
            COMMON
            | {
                "CenterX": enabled("CenterX"),
                "CenterY": enabled("CenterY"),
                "SequenceEnable": enabled("SequenceEnable"),
                "TestImageSelector": off("TestImageSelector", "Testimage2"),
            },
            factor=lambda raw: decibel(0.0359 * raw),
            options={"shutter": "global"},
            **OF_SFNC_1,
        ),
        Kind(
            "acA5472-17um",
            "BaslerUsb",
            sensor(5472, 3648, 4, 2, "Mono8", "Mono12", "Mono12p")
            | sfnc_2(23.59, "ResultingFrameRate")
            | {"ShutterMode": choice("ShutterMode", "Rolling", "GlobalResetRelease")},
            COMMON
            | {
                "ReverseY": enabled("ReverseY"),
                "Gamma": (number("Gamma", 0.45, 0.0, 3.99), 1.0),
                "DigitalShift": (integer("DigitalShift", 1, 0, 4), 0),
                "PgiMode": off("PgiMode", "On"),
                "NoiseReduction": zero("NoiseReduction", 0.5),
                "SharpnessEnhancement": zero("SharpnessEnhancement", 1.0),
                "SequencerMode": off("SequencerMode", "On"),
                "DecimationHorizontal": one("DecimationHorizontal"),
                "ExposureTimeMode": (choice("ExposureTimeMode", "UltraShort", "Standard"), "Standard"),
                "TestImageSelector": off("TestImageSelector", "Testimage1"),
            },
            factor=decibel,
            **OF_SFNC_2,
        ),
        Kind(
            "a2A4096-9gmBAS",
            "BaslerGigE",
            sensor(4096, 3000, 8, 2, "Mono8", "Mono12", "Mono12p")
            | sfnc_2(48.0, "BslResultingAcquisitionFrameRate")
            | ETHERNET
            | {"SensorShutterMode": choice("SensorShutterMode", "Global")},
            COMMON
            | {
                "ReverseY": enabled("ReverseY"),
                "Gamma": (number("Gamma", 0.45, 0.0, 4.0), 1.0),
                "BslBrightness": zero("BslBrightness", 0.3),
                "BslContrast": zero("BslContrast", 0.3),
                "BslDefectPixelCorrectionMode": off("BslDefectPixelCorrectionMode", "On"),
                "BslMultipleROIRowsEnable": enabled("BslMultipleROIRowsEnable"),
                "BlackLevelAuto": off("BlackLevelAuto", "Continuous"),
                "SequencerMode": off("SequencerMode", "On"),
                "TestPattern": off("TestPattern", "GreyHorizontalRamp"),
            },
            factor=decibel,
            **OF_SFNC_2,
        ),
        Kind(
            "a2A1920-160umPRO",
            "BaslerUsb",
            sensor(1920, 1200, 8, 2, "Mono8", "Mono12", "Mono12p")
            | sfnc_2(48.0, "BslResultingAcquisitionFrameRate")
            | {"SensorShutterMode": choice("SensorShutterMode", "Global", "Rolling")},
            COMMON
            | {
                "ReverseY": enabled("ReverseY"),
                "Gamma": (number("Gamma", 0.45, 0.0, 4.0), 1.0),
                "BslSharpnessEnhancement": zero("BslSharpnessEnhancement", 0.5),
                "BslNoiseReduction": zero("BslNoiseReduction", 0.5),
                "BslImageCompressionMode": off("BslImageCompressionMode", "BaslerCompressionBeyond"),
                "BslVignettingCorrectionMode": off("BslVignettingCorrectionMode", "On"),
                "BslFlatFieldCorrectionMode": off("BslFlatFieldCorrectionMode", "On"),
                "BslScalingFactor": (number("BslScalingFactor", 0.5, 0.1, 1.0), 1.0),
                "BslExposureTimeMode": (choice("BslExposureTimeMode", "Short", "Standard"), "Standard"),
                "TestPattern": off("TestPattern", "Black"),
            },
            factor=decibel,
            **OF_SFNC_2,
        ),
    )
}
"""By model."""
