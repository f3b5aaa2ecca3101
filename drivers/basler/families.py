"""What is known of Basler's camera families beyond the names that `drivers.genicam.names` lists.

A camera lists its own features. What it does not report is here: which nodes belong to its family, so that
a missing one is noticed, and what the integer `GainRaw` of some models means. 0.0359 dB per step is the
manual's formula for models with CCD sensors; over USB the same sensors have their range in dB. For CMOSIS
sensors the gain is 20 log10(GainRaw / 32). For other models the rig file states what GainRaw means.

Source: Basler, User's Manual for GigE Vision cameras (AW000893) and for USB 3.0 cameras (AW001234), chapters
on gain; Basler product documentation, parameter reference.
"""

import re
from dataclasses import dataclass

from drivers.genicam.names import RawSettings
from drivers.genicam.options import RawGain


@dataclass(frozen=True)
class Family:
    """Cameras that have the same nodes."""

    name: str  # for messages
    models: str  # regular expression for the beginning of the model's name
    nodes: tuple[str, ...]  # nodes on which the driver relies, and that all models of the family have


_ALL = (
    *("Width", "Height", "OffsetX", "OffsetY", "PixelFormat", "ExposureAuto", "GainAuto", "GainSelector"),
    *("TriggerSelector", "TriggerMode", "TriggerSource", "TriggerActivation"),
    *("LineSelector", "LineMode", "LineInverter"),
)
_SFNC_1 = (
    *("ExposureTimeAbs", "GainRaw", "BlackLevelRaw", "TriggerDelayAbs", "LineDebouncerTimeAbs"),
    *("ReadoutTimeAbs", "ResultingFrameRateAbs", "TestImageSelector"),
)
_SFNC_2 = (*("ExposureTime", "Gain", "BlackLevel", "TriggerDelay", "LineDebouncerTime", "SensorReadoutTime"),)
_ETHERNET = ("GevSCPSPacketSize", "GevSCPD")

FAMILIES = (
    Family("ace, ace U or ace L over Ethernet", r"acA\d+-\d+g", _ALL + _SFNC_1 + _ETHERNET),
    Family("ace, ace U or ace L over USB", r"acA\d+-\d+u", (*_ALL, *_SFNC_2, "ResultingFrameRate")),
    Family(
        "ace 2 over Ethernet",
        r"a2A\d+-\d+g",
        (*_ALL, *_SFNC_2, *_ETHERNET, "TestPattern", "BslResultingAcquisitionFrameRate"),
    ),
    Family(
        "ace 2 over USB", r"a2A\d+-\d+u", (*_ALL, *_SFNC_2, "TestPattern", "BslResultingAcquisitionFrameRate")
    ),
)
"""Families whose nodes are known; any other camera is used by the features that it lists."""

RAW_GAINS = (
    (r"acA(2000-50|2040-25)g", RawGain(unity=32.0)),
    (r"acA(640-90|640-100|645-100|750-30|780-75|1300-30|1600-20)g", RawGain(db_per_step=0.0359)),
)
"""By the beginning of the model's name, what GainRaw means."""

BASLER_RAW: RawSettings = (
    (("SequenceEnable",), False),
    (("ExposureTimeMode", "BslExposureTimeMode"), "Standard"),
    (("BslImageCompressionMode",), "Off"),
    (("DigitalShift",), 0),
    (("PgiMode",), "Off"),
    (("NoiseReduction", "NoiseReductionAbs"), 0.0),
    (("SharpnessEnhancement", "SharpnessEnhancementAbs"), 0.0),
    (("BslBrightness",), 0.0),
    (("BslContrast",), 0.0),
    (("BslSharpnessEnhancement",), 0.0),
    (("BslNoiseReduction",), 0.0),
    (("BslDefectPixelCorrectionMode",), "Off"),
    (("BslVignettingCorrectionMode",), "Off"),
    (("BslFlatFieldCorrectionMode",), "Off"),
    (("ScalingHorizontal",), 1.0),
    (("ScalingVertical",), 1.0),
    (("BslScalingFactor",), 1.0),
    (("StackedZoneImagingEnable",), False),
    (("BslMultipleROIRowsEnable",), False),
    (("BslMultipleROIColumnsEnable",), False),
    (("CenterX",), False),
    (("CenterY",), False),
    (("TestImageSelector",), "Off"),
    (("LightSourcePreset", "BslLightSourcePreset", "LightSourceSelector"), "Off"),
)
"""Basler's own features and the values at which frames are the sensor's."""


def family_of(model: str) -> Family | None:
    return next((family for family in FAMILIES if re.match(family.models, model)), None)


def raw_gain_of(model: str) -> RawGain | None:
    return next((gain for models, gain in RAW_GAINS if re.match(models, model)), None)
