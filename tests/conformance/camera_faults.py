"""Faults in the tables of nodes and in the drivers of GenTL and video cameras."""

from __future__ import annotations

from tests.conformance.fault import Fault

BASLER, FAMILIES, LINK = (f"drivers/basler/{name}.py" for name in ("camera", "families", "link"))
NAMES, GAIN, PIXELS = (f"drivers/genicam/{name}.py" for name in ("names", "gain", "pixels"))
GENTL, PRODUCER = (f"drivers/gentl/{name}.py" for name in ("camera", "producer"))
VIDEO, CONTROLS = (f"drivers/video_camera/{name}.py" for name in ("camera", "controls"))


FRESH = "begin_s + settings.exposure_s + self._period_s + self._options.latency_s"
ROWS = "frame.pixels[: height * pitch].reshape(height, pitch)"


def in_table(name: str, file: str, table: str, old: str, new: str) -> Fault:
    return Fault(f"nodes: {name}", file, table, old, new)


NODE_TABLES = [
    in_table(
        "a sequence of settings goes on",
        *(FAMILIES, "BASLER_RAW", '(("SequenceEnable",), False)', '(("SequenceEnable",), True)'),
    ),
    in_table(
        "frames are compressed",
        *(FAMILIES, "BASLER_RAW", '(("BslImageCompressionMode", "ImageCompressionMode"), "Off")'),
        '(("ImageCompressionMode",), "Off")',
    ),
    in_table(
        "defect pixels are painted over",
        *(FAMILIES, "BASLER_RAW", '(("BslDefectPixelCorrectionMode",), "Off")'),
        '(("BslDefectPixelCorrectionMode",), "On")',
    ),
    in_table(
        "zones are stacked",
        *(FAMILIES, "BASLER_RAW", '(("StackedZoneImagingEnable",), False)', '(("PgiMode",), "Off")'),
    ),
    in_table(
        "the region is centred", FAMILIES, "BASLER_RAW", '(("CenterX",), False)', '(("CenterY",), False)'
    ),
    in_table(
        "frames are scaled",
        *(FAMILIES, "BASLER_RAW", '(("BslScalingFactor",), 1.0)', '(("BslScalingFactor",), 0.5)'),
    ),
    in_table(
        "noise is reduced before SFNC 2 only",
        *(FAMILIES, "BASLER_RAW", '(("NoiseReduction", "NoiseReductionAbs"), 0.0)'),
        '(("NoiseReductionAbs",), 0.0)',
    ),
    in_table(
        "a short exposure mode stays",
        *(FAMILIES, "BASLER_RAW", '(("ExposureTimeMode", "BslExposureTimeMode"), "Standard")'),
        '(("ExposureTimeMode",), "Standard")',
    ),
    in_table("the sequencer runs", NAMES, "RAW", '(("SequencerMode",), "Off")', '(("SequencerMode",), "On")'),
    in_table(
        "the black level follows", NAMES, "RAW", '(("BlackLevelAuto",), "Off")', '(("GainAuto",), "Off")'
    ),
    in_table(
        "the pulse is the exposure",
        *(NAMES, "RAW", '(("ExposureMode",), "Timed")', '(("ExposureMode",), "TriggerWidth")'),
    ),
    in_table("a look-up table", NAMES, "RAW", '(("LUTEnable",), False)', '(("LUTEnable",), True)'),
    in_table(
        "the debouncer before SFNC 2",
        *(NAMES, "LINE_DEBOUNCER_US", '("LineDebouncerTime", "LineDebouncerTimeAbs")'),
        '("LineDebouncerTime",)',
    ),
    in_table(
        "the trigger's delay before SFNC 2",
        *(NAMES, "TRIGGER_DELAY_US", '("TriggerDelay", "TriggerDelayAbs")', '("TriggerDelay",)'),
    ),
    in_table(
        "the black level before SFNC 2",
        *(NAMES, "BLACK_LEVEL", '("BlackLevel", "BlackLevelRaw")', '("BlackLevel",)'),
    ),
    in_table(
        "one channel's gain",
        *(NAMES, "ALL_CHANNELS", '(("GainSelector",), ("BlackLevelSelector",))'),
        '(("BlackLevelSelector",),)',
    ),
    in_table("another unity", FAMILIES, "RAW_GAINS", "RawGain(unity=32.0)", "RawGain(unity=64.0)"),
    in_table(
        "another step", FAMILIES, "RAW_GAINS", "RawGain(db_per_step=0.0359)", "RawGain(db_per_step=0.0365)"
    ),
    in_table("every model is the first", FAMILIES, "raw_gain_of", "re.match(models, model)", "models"),
    in_table(
        "the rig file is overruled",
        *(BASLER, "BaslerCamera._open", "self._options.raw_gain or raw_gain_of(info.GetModelName())"),
        "raw_gain_of(info.GetModelName()) or self._options.raw_gain",
    ),
    in_table(
        "the maker's features are forgotten",
        BASLER,
        "BaslerCamera.RAW",
        "named.RAW + BASLER_RAW",
        "named.RAW",
    ),
    in_table(
        "packets follow each other at once",
        *(BASLER, "BaslerCamera._apply_options", "(named.PACKET_DELAY_TICKS, options.packet_delay_ticks)"),
        "(named.PACKET_DELAY_TICKS, None)",
    ),
    in_table(
        "a missing node is not told",
        *(BASLER, "BaslerCamera._warn_of_missing_nodes", "self._features.has((name,))", "name"),
    ),
    in_table(
        "repeats are not told",
        *(BASLER, "BaslerCamera._stop", "self._camera.IsGrabbing() and (lost := self._lost())"),
        "not self._camera.IsGrabbing() and (lost := self._lost())",
    ),
    in_table(
        "repeats are counted as losses",
        *(LINK, "LOST", '"Statistic_Resend_Packet_Count"', '"Statistic_Failed_Packet_Count"'),
    ),
    in_table(
        "what is not lost is told",
        *(LINK, "lost_on_link", "(count := node.GetValue()) > 0", "(count := node.GetValue()) >= 0"),
    ),
]

GENTL_AND_VIDEO = [
    Fault("gentl: armed before it is ready", GENTL, "GentlCamera._arm", 'self._await_ready("arm")', ""),
    Fault("gentl: every layer counts as it likes", PRODUCER, "FIRST_FRAME", '{"U3V": 0, "GEV": 1}', "{}"),
    Fault(
        "gentl: the host counts",
        *(GENTL, "GentlCamera._read", "frame.number - self._first", "self._taken"),
    ),
    Fault(
        "gentl: left-justified pixels pass",
        *(GENTL, "GentlCamera._read", "frame.image.max() >> settings.bits", "frame.image.max() >> 16"),
    ),
    Fault(
        "gentl: a gain without a unit is in dB",
        *(GENTL, "GentlCamera._open", '(None, "dB")', '(None, "", "dB")'),
    ),
    Fault("gentl: an exposure of its own", GENTL, "GentlCamera._open", "self._need_exposure()", ""),
    Fault(
        "gentl: still started in fault",
        *(GENTL, "GentlCamera._fault", "self._end.stop()", "self._end.GetNodeMap()"),
    ),
    Fault(
        "gentl: a camera in use is a mystery",
        *(GENTL, "GentlCamera._described"),
        "gentl.ResourceInUseException | gentl.AccessDeniedException",
        "gentl.BusyException",
    ),
    Fault(
        "gentl: Ctrl-C is the library's", PRODUCER, "_own_ctrl_c", "signal.signal(signal.SIGINT, own)", "own"
    ),
    Fault(
        "gentl: buffers are kept",
        PRODUCER,
        "_returned",
        "buffer.parent.queue_buffer(buffer)",
        "buffer.parent",
    ),
    Fault(
        "gentl: an incomplete frame is the end",
        *(PRODUCER, "GentlEnd.fetch", "if left_s <= 0.0:", "if buffer is None:"),
    ),
    Fault(
        "gentl: rows have no padding", PRODUCER, "GentlEnd._image", "lambda: buffer.padding_x", "lambda: 0"
    ),
    Fault(
        "gentl: frames begin with the buffer",
        *(PRODUCER, "GentlEnd._image", "lambda: buffer.image_offset", "lambda: 0"),
    ),
    Fault("pixels: rows follow each other", PIXELS, "_rows", "row_bytes + padding", "row_bytes"),
    Fault("pixels: packed rows never begin anew", PIXELS, "unpack12", "if not padding:", "if height:"),
    Fault("pixels: frames share the buffer", PIXELS, "image_from", "rows.copy()", "np.asarray(rows)"),
    Fault(
        "pixels: half a frame is one",
        *(PIXELS, "_rows", "raw.size < pitch * height - padding", "raw.size < row_bytes"),
    ),
    Fault(
        "packed is not a choice",
        *("drivers/genicam/camera.py", "GenicamCamera._format", "not self._options.packed", "self._options"),
    ),
    Fault(
        "gentl: raw numbers are dB",
        *(GAIN, "CameraGain.__init__", "GAIN_RAW if in_db else GAIN_DB", "GAIN_RAW"),
    ),
    Fault(
        "video: stale frames pass",
        *(VIDEO, "VideoCamera._read", "if frame.time_s >= fresh_s:", "if frame.time_s:"),
    ),
    Fault(
        "video: times to come pass",
        *(VIDEO, "VideoCamera._read", "frame.time_s > time.monotonic() + CLOCK_S", "not frame.time_s"),
    ),
    Fault(
        "video: frames under way pass",
        *(VIDEO, "VideoCamera._read", "begin_s + settings.exposure_s + self._period_s", "begin_s"),
    ),
    Fault(
        "video: the readout takes no time",
        *(
            VIDEO,
            "VideoCamera._read",
            "begin_s + settings.exposure_s + self._period_s + self._options.latency_s",
        ),
        "begin_s + settings.exposure_s + self._options.latency_s",
    ),
    Fault(
        "video: frames are never held back",
        *(
            VIDEO,
            "VideoCamera._read",
            "begin_s + settings.exposure_s + self._period_s + self._options.latency_s",
        ),
        "begin_s + settings.exposure_s + self._period_s",
    ),
    Fault("video: the gamma is the default", CONTROLS, "RAW", "100", "None"),
    Fault("video: the exposure stays automatic", CONTROLS, "RAW", "MANUAL", "3"),
    Fault("video: frames are mirrored", CONTROLS, "RAW", "0x0098_0914", "0x0098_09FF"),
    Fault(
        "video: raw is hoped for",
        *(VIDEO, "VideoCamera._make_raw"),
        "(found := self._device.get(number)) != value",
        "(found := self._device.get(number)) is None",
    ),
    Fault(
        "video: converted frames pass",
        *(VIDEO, "FORMATS", '{"GREY": 8, "Y10 ": 10, "Y12 ": 12, "Y14 ": 14, "Y16 ": 16}'),
        *('{"YUYV": 8, "GREY": 8, "Y12 ": 12}',),
    ),
    Fault("video: another unit of exposure", VIDEO, "UNIT_S", "1e-4", "1e-3"),
    Fault(
        "video: damaged frames pass",
        *(VIDEO, "VideoCamera._image", "frame.is_damaged", "False"),
    ),
    Fault(
        "video: an unplugged camera is a mystery",
        *(VIDEO, "VideoCamera._described", "(errno.ENODEV, errno.ENXIO)", "(errno.ENXIO,)"),
    ),
    Fault(
        "video: the gain is as asked for",
        *(VIDEO, "VideoCamera._set_gain"),
        "return to_db(self._set(GAIN, round(to_raw(gain_db, conversion)), self._gain), conversion)",
        "return gain_db",
    ),
    Fault(
        "video: the rows' margin is picture",
        *(
            VIDEO,
            "VideoCamera._image",
            "frame.pixels[: height * pitch].reshape(height, pitch)[:, : width * dtype.itemsize]",
        ),
        *("frame.pixels[: height * pitch].reshape(height, pitch)[:, -width * dtype.itemsize :]",),
    ),
]
