"""Names of camera features: those of SFNC 2 first, then those that cameras had before.

Source: GenICam Standard Features Naming Convention (SFNC) 2.7; Basler's parameter reference for SFNC 1 names.
"""

from drivers.genicam.features import FeatureNames

US_PER_S = 1e6  # genICam states times in µs (Standard Features Naming Convention)

WIDTH, HEIGHT, OFFSET_X, OFFSET_Y = ("Width",), ("Height",), ("OffsetX",), ("OffsetY",)
PIXEL_FORMAT: FeatureNames = ("PixelFormat",)
PAYLOAD_BYTES: FeatureNames = ("PayloadSize",)
EXPOSURE_US: FeatureNames = ("ExposureTime", "ExposureTimeAbs")
GAIN_DB: FeatureNames = ("Gain",)
GAIN_RAW: FeatureNames = ("GainRaw",)
BLACK_LEVEL: FeatureNames = ("BlackLevel", "BlackLevelRaw")
TEMPERATURE_C: FeatureNames = ("DeviceTemperature", "TemperatureAbs")
SHUTTER: FeatureNames = ("SensorShutterMode", "ShutterMode")
READOUT_US: FeatureNames = ("SensorReadoutTime", "ReadoutTimeAbs")
RESULTING_HZ: FeatureNames = (
    "ResultingFrameRate",
    "BslResultingAcquisitionFrameRate",
    "ResultingFrameRateAbs",
    "AcquisitionResultingFrameRate",
    "CurrentAcquisitionFrameRate",
    "AcquisitionFrameRateLimit",
)
FRAME_RATE_HZ: FeatureNames = ("AcquisitionFrameRate",)
USB_SPEED: FeatureNames = ("BslUSBSpeedMode",)
PACKET_BYTES: FeatureNames = ("GevSCPSPacketSize",)
PACKET_DELAY_TICKS: FeatureNames = ("GevSCPD",)
STATUS_SELECTOR: FeatureNames = ("AcquisitionStatusSelector",)
STATUS: FeatureNames = ("AcquisitionStatus",)
SOFTWARE_TRIGGER: FeatureNames = ("TriggerSoftware",)
TICKS_PER_S: FeatureNames = ("GevTimestampTickFrequency",)
TRIGGER_SELECTOR: FeatureNames = ("TriggerSelector",)
FRAME_TRIGGERS = ("FrameStart", "ExposureStart")
"""Values of `TRIGGER_SELECTOR` whose trigger starts the exposure of one frame, the preferred one first."""
TRIGGER_OVERLAP: FeatureNames = ("TriggerOverlap",)
OVERLAPS = ("ReadOut", "PreviousFrame")
"""Values of `TRIGGER_OVERLAP` at which a trigger counts while the frame before is read out."""
TRIGGER_MODE: FeatureNames = ("TriggerMode",)
TRIGGER_SOURCE: FeatureNames = ("TriggerSource",)
TRIGGER_EDGE: FeatureNames = ("TriggerActivation",)
TRIGGER_DELAY_US: FeatureNames = ("TriggerDelay", "TriggerDelayAbs")
LINE_SELECTOR: FeatureNames = ("LineSelector",)
LINE_MODE: FeatureNames = ("LineMode",)
LINE_SOURCE: FeatureNames = ("LineSource",)
LINE_INVERTER: FeatureNames = ("LineInverter",)
LINE_DEBOUNCER_US: FeatureNames = ("LineDebouncerTime", "LineDebouncerTimeAbs")
GAIN_SELECTOR: FeatureNames = ("GainSelector",)
GAMMA: FeatureNames = ("Gamma",)
GAMMA_ENABLE: FeatureNames = ("GammaEnable", "GammaEnabled")

ALL_CHANNELS: tuple[FeatureNames, ...] = (GAIN_SELECTOR, ("BlackLevelSelector",))
"""Selectors of what gain and black level apply to; the first of `WHOLE` that the camera has."""
WHOLE = ("All", "AnalogAll", "DigitalAll")

RawSettings = tuple[tuple[FeatureNames, object], ...]  # features and the values that they must have

RAW: RawSettings = (
    (("SequencerMode",), "Off"),
    (("AcquisitionMode",), "Continuous"),
    (("AcquisitionFrameRateEnable",), False),
    (("ExposureMode",), "Timed"),
    (("ExposureAuto",), "Off"),
    (("GainAuto",), "Off"),
    (("BlackLevelAuto",), "Off"),
    (("BalanceWhiteAuto",), "Off"),
    (GAMMA_ENABLE, False),
    (GAMMA, 1.0),
    (("LUTEnable",), False),
    (("ImageCompressionMode",), "Off"),
    (("BinningHorizontal",), 1),
    (("BinningVertical",), 1),
    (("DecimationHorizontal",), 1),
    (("DecimationVertical",), 1),
    (("ReverseX",), False),
    (("ReverseY",), False),
    (("TestPattern",), "Off"),
    (("ChunkModeActive",), False),
)
"""Settings of SFNC for raw values of every sensor pixel, exposed at the times of their triggers.

A camera may lack any of them; those that it has must have these values. Makers add their own.
"""

SELECTED_RAW: tuple[tuple[FeatureNames, FeatureNames, object], ...] = (
    (("BalanceRatioSelector",), ("BalanceRatio", "BalanceRatioAbs"), 1.0),
    (("LUTSelector",), ("LUTEnable",), False),
)
"""The same for features that have a value for each entry of a selector: selector, feature and value."""
