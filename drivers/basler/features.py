"""The features of a camera by their GenICam names: the node map is asked what there is.

Cameras differ by model and by the version of the Standard Features Naming Convention (SFNC). A feature is
therefore a row of names, those of SFNC 2 first; the first that the camera has counts.
"""

from __future__ import annotations

from typing import Any

from pypylon import pylon

from fpplab.core.errors import CapabilityError, SettingError

FeatureNames = tuple[str, ...]
US_PER_S = 1e6

WIDTH, HEIGHT, OFFSET_X, OFFSET_Y = ("Width",), ("Height",), ("OffsetX",), ("OffsetY",)
PIXEL_FORMAT: FeatureNames = ("PixelFormat",)
PAYLOAD_BYTES: FeatureNames = ("PayloadSize",)
EXPOSURE_US: FeatureNames = ("ExposureTime", "ExposureTimeAbs")
GAIN_DB: FeatureNames = ("Gain",)
BLACK_LEVEL: FeatureNames = ("BlackLevel",)
SHUTTER: FeatureNames = ("SensorShutterMode", "ShutterMode")
READOUT_US: FeatureNames = ("SensorReadoutTime", "ReadoutTimeAbs")
TICKS_PER_S: FeatureNames = ("GevTimestampTickFrequency",)
TRIGGER_SELECTOR: FeatureNames = ("TriggerSelector",)
TRIGGER_MODE: FeatureNames = ("TriggerMode",)
TRIGGER_SOURCE: FeatureNames = ("TriggerSource",)
TRIGGER_EDGE: FeatureNames = ("TriggerActivation",)
TRIGGER_DELAY_US: FeatureNames = ("TriggerDelay", "TriggerDelayAbs")
LINE_SELECTOR: FeatureNames = ("LineSelector",)
LINE_MODE: FeatureNames = ("LineMode",)

RAW: tuple[tuple[FeatureNames, object], ...] = (
    (("AcquisitionMode",), "Continuous"),
    (("AcquisitionFrameRateEnable",), False),
    (("ExposureMode",), "Timed"),
    (("ExposureAuto",), "Off"),
    (("GainAuto",), "Off"),
    (("GammaEnable",), False),
    (("Gamma",), 1.0),
    (("LUTEnable",), False),
    (("DigitalShift",), 0),
    (("ChunkModeActive",), False),
)
"""What makes frames the sensor's raw integers, at the times of their triggers; a camera may lack any."""


class Features:
    """The features of one open camera.

    device: its name in the rig file, for errors. camera: pylon's `InstantCamera`, which is asked for its node
    map each time: of a camera that was unplugged it has none, whereas an old map goes on answering.
    """

    def __init__(self, device: str, camera: Any) -> None:
        self._device, self._camera = device, camera

    def has(self, feature: FeatureNames) -> bool:
        """Whether the camera has it in its present mode."""
        return bool(self._node(feature).IsValid())

    def read(self, feature: FeatureNames) -> Any:
        """Its value, or None where the camera does not tell."""
        node = self._node(feature)
        return node.GetValue() if node.IsReadable() else None

    def limits(self, feature: FeatureNames) -> tuple[float, float]:
        """The least and the greatest that it takes now. Raises `CapabilityError` when it is not there."""
        node = self._node(feature)
        if not node.IsReadable():
            raise CapabilityError(self._device, "caps", f"the camera has no {feature[0]}")
        return float(node.GetMin()), float(node.GetMax())

    def choices(self, feature: FeatureNames) -> tuple[str, ...]:
        """What a choice can be set to now; nothing where the camera has no such choice."""
        node = self._node(feature)
        return tuple(node.GetSettableValues()) if node.IsWritable() else ()

    def write(self, feature: FeatureNames, value: Any, operation: str, tolerance: float = 0.0) -> Any:
        """Set it and return what is read back.

        Raises `CapabilityError` where the camera has it not, `SettingError` for a value that it does not
        take, and for one that reads back more than `within` off.
        """
        node = self._node(feature)
        if not node.IsWritable():
            if node.IsReadable() and node.GetValue() == value:
                return value
            raise CapabilityError(
                self._device,
                operation,
                f"{feature[0]} cannot be set to {value}",
                "this camera has no such setting",
            )
        if refusal := _refusal(node, value):
            raise SettingError(
                self._device, operation, f"{feature[0]} is {_shown(value)}", f"the camera takes {refusal}"
            )
        node.SetValue(value)
        back = node.GetValue()
        if back != value and not (tolerance and abs(back - value) <= tolerance):
            raise SettingError(
                self._device,
                operation,
                f"{feature[0]} is {_shown(value)}",
                f"the camera reads {_shown(back)}",
            )
        return back

    def write_if_possible(self, feature: FeatureNames, value: Any) -> None:
        """Set it where the camera can, and leave alone what it has not."""
        node = self._node(feature)
        if node.IsWritable() and not _refusal(node, value):
            node.SetValue(value)

    def _node(self, feature: FeatureNames) -> Any:
        node_map = self._camera.GetNodeMap()
        nodes = [node_map.GetNode(name) for name in feature]
        return next((node for node in nodes if node.IsValid()), nodes[0])


def _refusal(node: Any, value: Any) -> str:
    """What the node takes instead, or nothing when it takes the value."""
    if isinstance(node, pylon.EnumParameter):
        choices = node.GetSettableValues()
        return "" if value in choices else f"one of {', '.join(choices)}"
    if isinstance(node, pylon.BooleanParameter):
        return ""
    least, most = node.GetMin(), node.GetMax()
    step = node.GetInc() if isinstance(node, pylon.IntegerParameter) else 0
    if least <= value <= most and not (step and (value - least) % step):
        return ""
    return f"{least:g} to {most:g}" + (f" in steps of {step}" if step > 1 else "")


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
