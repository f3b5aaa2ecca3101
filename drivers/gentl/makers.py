"""What cameras of other makers add to the names of `drivers.genicam.names`, one entry for each maker.

A camera may lack any of the features. The names are those of public node lists and headers. FLIR: technical
reference of Blackfly S, list of Spinnaker's nodes in rotpy, node dumps of Chameleon3 in simple_pyspin and of
Grasshopper3 in storm-control. IDS: what public programs for IDS peak read and write, as its manual was not at
hand. Daheng: in part. None of the tables has been compared with a camera.
"""

import re
from dataclasses import dataclass

from drivers.genicam.features import FeatureNames
from drivers.genicam.names import SELECTED_RAW, RawSettings


@dataclass(frozen=True)
class Maker:
    """Cameras that share names; the defaults are those of SFNC."""

    vendors: str  # regular expression for the beginning of the vendor's name, in any case
    line: str = "Line1"  # its isolated trigger input
    raw: RawSettings = ()
    selected_raw: tuple[tuple[FeatureNames, FeatureNames, object], ...] = SELECTED_RAW
    gain_is_factor: bool = False  # whether `Gain` is a factor instead of dB
    rate_is_limit: bool = False
    """Whether the greatest `AcquisitionFrameRate` is the one that exposure, readout and link allow, for
    cameras without another feature that tells it."""


COLOUR = (("ColorTransformationEnable",), False)

FLIR = Maker(
    "FLIR|Teledyne FLIR|Point Grey",
    line="Line0",
    raw=(
        (("VideoMode",), "Mode0"),  # others bin, and some correct defective pixels without telling
        (("AcquisitionFrameRateAuto",), "Off"),
        (("AcquisitionFrameRateEnabled",), False),
        (("pgrExposureCompensationAuto",), "Off"),
        (("SharpeningAuto",), False),
        (("SharpeningEnable", "SharpnessEnabled"), False),
        (("DefectCorrectStaticEnable", "pgrDefectPixelCorrectionEnable"), False),
        (("BlackLevelClampingEnable",), False),
        (("SaturationEnable", "SaturationEnabled"), False),
        (("HueEnabled",), False),
        (("IspEnable", "OnBoardColorProcessEnabled"), False),
        COLOUR,
        (("AdaptiveCompressionEnable",), False),
    ),
    rate_is_limit=True,
)
IDS = Maker(
    "IDS",
    line="Line0",
    raw=((("AcquisitionFrameRateTargetEnable",), False),),
    gain_is_factor=True,
    rate_is_limit=True,
)
ALLIED_VISION = Maker(
    "Allied Vision",
    line="Line0",
    raw=(
        (("ConvolutionMode",), "Off"),
        (("ContrastEnable",), False),
        (("AdaptiveNoiseSuppressionFactor",), 1.0),
        (("Sharpness",), 0),
        (("Hue",), 0.0),
        (("Saturation",), 1.0),
        (("DefectMaskEnable",), False),
        COLOUR,
    ),
    selected_raw=(*SELECTED_RAW, (("CorrectionSelector",), ("CorrectionMode",), "Off")),
    rate_is_limit=True,
)
HIKROBOT = Maker(
    "Hik",
    line="Line0",
    raw=(
        (("TriggerCacheEnable",), False),
        (("HDREnable",), False),
        (("DigitalShiftEnable",), False),
        (("SharpnessEnable",), False),
        (("ContrastRatioEnable",), False),
        (("HueEnable",), False),
        (("SaturationEnable",), False),
        (("NUCEnable",), False),
        (("FPNCEnable",), False),
        (("PRNUCEnable",), False),
        COLOUR,
    ),
)
DAHENG = Maker(
    "Daheng|China Daheng",
    line="Line0",
    raw=(
        (("AcquisitionFrameRateMode",), "Off"),
        (("DigitalShift",), 0),
        (("SharpnessMode",), "Off"),
        (("DeadPixelCorrect",), "Off"),
        (("FlatFieldCorrection",), "Off"),
        (("NoiseReductionMode",), "Off"),
        (("ColorCorrect",), "Off"),
        (("HDRMode",), "Off"),
        (("ContrastParam",), 0),
        (("ImageGrayRaiseSwitch",), "Off"),
        COLOUR,
    ),
)
JAI = Maker(
    "JAI",
    line="Line5",
    raw=(
        (("LUTMode",), "Off"),
        (("BlemishEnable",), False),
        (("ShadingMode", "ShadingCorrectionMode"), "Off"),
        (("ColorTransformationRGBMode",), "Off"),
        (("IndividualGainMode",), "Off"),
        (("ExposureModeOption",), "Off"),
        (("ShortExposureMode",), "Off"),
    ),
    gain_is_factor=True,
    rate_is_limit=True,
)

MAKERS = (FLIR, IDS, ALLIED_VISION, HIKROBOT, DAHENG, JAI)


def maker_of(vendor: str) -> Maker:
    """Give what is known of a maker's cameras; of an unknown maker the names of SFNC."""
    return next((maker for maker in MAKERS if re.match(maker.vendors, vendor, re.IGNORECASE)), Maker(""))
