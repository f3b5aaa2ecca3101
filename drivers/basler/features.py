"""Camera features by their GenICam names, resolved in the camera's node map.

Cameras differ by model and by the version of the Standard Features Naming Convention (SFNC). A feature is
therefore a tuple of names, those of SFNC 2 first; the first that the camera has is used.
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
GAIN_RAW: FeatureNames = ("GainRaw",)
BLACK_LEVEL: FeatureNames = ("BlackLevel", "BlackLevelRaw")
SHUTTER: FeatureNames = ("SensorShutterMode", "ShutterMode")
READOUT_US: FeatureNames = ("SensorReadoutTime", "ReadoutTimeAbs")
RESULTING_HZ: FeatureNames = (
    "ResultingFrameRate",
    "BslResultingAcquisitionFrameRate",
    "ResultingFrameRateAbs",
)
USB_SPEED: FeatureNames = ("BslUSBSpeedMode",)
TICKS_PER_S: FeatureNames = ("GevTimestampTickFrequency",)
TRIGGER_SELECTOR: FeatureNames = ("TriggerSelector",)
TRIGGER_MODE: FeatureNames = ("TriggerMode",)
TRIGGER_SOURCE: FeatureNames = ("TriggerSource",)
TRIGGER_EDGE: FeatureNames = ("TriggerActivation",)
TRIGGER_DELAY_US: FeatureNames = ("TriggerDelay", "TriggerDelayAbs")
LINE_SELECTOR: FeatureNames = ("LineSelector",)
LINE_MODE: FeatureNames = ("LineMode",)
LINE_INVERTER: FeatureNames = ("LineInverter",)
LINE_DEBOUNCER_US: FeatureNames = ("LineDebouncerTime", "LineDebouncerTimeAbs")
GAMMA: FeatureNames = ("Gamma",)
GAMMA_ENABLE: FeatureNames = ("GammaEnable",)

ALL_CHANNELS: tuple[FeatureNames, ...] = (("GainSelector",), ("BlackLevelSelector",))
"""Selectors of what gain and black level apply to; "All" where the camera has it."""

RAW: tuple[tuple[FeatureNames, object], ...] = (
    (("AcquisitionMode",), "Continuous"),
    (("AcquisitionFrameRateEnable",), False),
    (("ExposureMode",), "Timed"),
    (("ExposureAuto",), "Off"),
    (("GainAuto",), "Off"),
    (GAMMA_ENABLE, False),
    (GAMMA, 1.0),
    (("LUTEnable",), False),
    (("DigitalShift",), 0),
    (("PgiMode",), "Off"),
    (("BslBrightness",), 0.0),
    (("BslContrast",), 0.0),
    (("BslSharpnessEnhancement",), 0.0),
    (("BslNoiseReduction",), 0.0),
    (("BinningHorizontal",), 1),
    (("BinningVertical",), 1),
    (("DecimationHorizontal",), 1),
    (("DecimationVertical",), 1),
    (("ReverseX",), False),
    (("ReverseY",), False),
    (("TestImageSelector",), "Off"),
    (("TestPattern",), "Off"),
    (("ChunkModeActive",), False),
)
"""Settings for raw values of every sensor pixel, exposed at the times of their triggers.

A camera may lack any of them; those that it has must have these values.
"""


class Features:
    """The GenICam features of one open camera.

    The node map is fetched anew for each access: an unplugged camera has none, whereas a stored node map goes
    on answering.

    Parameters
    ----------
    device : str
        Name of the camera in the rig file, for errors.
    camera : pylon.InstantCamera
        The camera, open.
    """

    def __init__(self, device: str, camera: Any) -> None:
        self._device, self._camera = device, camera

    def has(self, feature: FeatureNames) -> bool:
        """Tell whether the camera has a feature in its present mode.

        Parameters
        ----------
        feature : tuple of str
            Names of the feature, in order of preference.

        Returns
        -------
        bool
            True where its node is valid.
        """
        return bool(self._node(feature).IsValid())

    def read(self, feature: FeatureNames) -> Any:
        """Read the value of a feature.

        Parameters
        ----------
        feature : tuple of str
            Names of the feature, in order of preference.

        Returns
        -------
        int or float or bool or str or None
            The value; None where the camera does not have the feature or it is not readable.
        """
        node = self._node(feature)
        return node.GetValue() if node.IsReadable() else None

    def limits(self, feature: FeatureNames) -> tuple[float, float]:
        """Read the range that a numeric feature takes at present.

        Parameters
        ----------
        feature : tuple of str
            Names of the feature, in order of preference.

        Returns
        -------
        tuple of float
            Minimum and maximum, in the feature's own unit.

        Raises
        ------
        CapabilityError
            The camera does not have the feature, or it is not readable.
        """
        node = self._node(feature)
        if not node.IsReadable():
            raise CapabilityError(self._device, "caps", f"the camera has no {feature[0]}")
        return float(node.GetMin()), float(node.GetMax())

    def choices(self, feature: FeatureNames) -> tuple[str, ...]:
        """List the values that an enumeration can be set to at present.

        Parameters
        ----------
        feature : tuple of str
            Names of the feature, in order of preference.

        Returns
        -------
        tuple of str
            The settable values; empty where the camera has no such enumeration or it is not writable.
        """
        node = self._node(feature)
        return tuple(node.GetSettableValues()) if node.IsWritable() else ()

    def write(self, feature: FeatureNames, value: Any, operation: str, tolerance: float = 0.0) -> Any:
        """Set a feature and read it back.

        Parameters
        ----------
        feature : tuple of str
            Names of the feature, in order of preference.
        value : int or float or bool or str
            The value to set.
        operation : str
            What the device is doing, for errors.
        tolerance : float
            Largest accepted difference between `value` and the value that is read back.

        Returns
        -------
        int or float or bool or str
            The value that is read back.

        Raises
        ------
        CapabilityError
            The feature is missing or not writable, and does not have this value already.
        SettingError
            The camera does not take the value, or another value is read back.
        """
        node = self._node(feature)
        if isinstance(node, pylon.IntegerParameter) and float(value).is_integer():
            value = int(value)
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

    def ensure(self, feature: FeatureNames, value: Any, operation: str) -> None:
        """Set a feature where the camera has it, and verify it.

        Parameters
        ----------
        feature : tuple of str
            Names of the feature, in order of preference.
        value : int or float or bool or str
            The value to set.
        operation : str
            What the device is doing, for errors.

        Raises
        ------
        SettingError
            The camera has the feature with another value, and keeps it.
        """
        self.write_if_possible(feature, value)
        found = self.read(feature)
        if found is not None and found != value:
            raise SettingError(
                self._device,
                operation,
                f"{feature[0]} is {_shown(found)} and cannot be set to {_shown(value)}",
                "frames would not be the sensor's own values; correct it in pylon Viewer",
            )

    def write_if_possible(self, feature: FeatureNames, value: Any) -> None:
        """Set a feature where the camera takes the value; otherwise leave it unchanged.

        Parameters
        ----------
        feature : tuple of str
            Names of the feature, in order of preference.
        value : int or float or bool or str
            The value to set.
        """
        node = self._node(feature)
        if node.IsWritable() and not _refusal(node, value):
            node.SetValue(value)

    def _node(self, feature: FeatureNames) -> Any:
        node_map = self._camera.GetNodeMap()
        nodes = [node_map.GetNode(name) for name in feature]
        return next((node for node in nodes if node.IsValid()), nodes[0])


def _refusal(node: Any, value: Any) -> str:
    """Describe what the node accepts, if it does not take the value; otherwise return an empty string."""
    if isinstance(node, pylon.EnumParameter):
        choices = node.GetSettableValues()
        return "" if value in choices else f"one of {', '.join(choices)}"
    if isinstance(node, pylon.BooleanParameter):
        return ""
    least, most = node.GetMin(), node.GetMax()
    step = node.GetInc() if isinstance(node, pylon.IntegerParameter) else 0
    if step and value != int(value):
        return f"whole numbers from {least:g} to {most:g}"
    if least <= value <= most and not (step and (value - least) % step):
        return ""
    return f"{least:g} to {most:g}" + (f" in steps of {step}" if step > 1 else "")


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)
