"""The Basler driver on what pylon's emulator lacks: other features, packed pixels, other counts."""

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pypylon import pylon

from drivers.basler import BaslerCamera
from drivers.genicam.pixels import unpack12
from fpplab.core.errors import CapabilityError, ConfigError, FrameLossError, SettingError
from fpplab.devices import CameraSettings, State
from tests.drivers.node_camera import (
    ACE,
    SERIAL,
    Node,
    NodeCamera,
    Result,
    choice,
    fixed,
    integer,
    number,
    switch,
)
from tests.drivers.test_pixels import packed

Make = Callable[..., BaslerCamera]


@pytest.fixture
def made() -> Iterator[Make]:
    """Opens the driver on a camera with the given options; closed afterwards."""
    opened: list[BaslerCamera] = []

    def make(end: NodeCamera, **options: Any) -> BaslerCamera:
        camera = BaslerCamera("camera", {"serial": SERIAL, **options}, SimpleNamespace(pylon=end))
        opened.append(camera)
        camera.open()
        return camera

    yield make
    for camera in opened:
        camera.close()


def without(*names: str) -> NodeCamera:
    return NodeCamera({name: node for name, node in ACE.items() if name not in names})


def but(**nodes: Any) -> NodeCamera:
    return NodeCamera({**ACE, **nodes})


def value(end: NodeCamera, name: str) -> Any:
    return end.map.GetNode(name).GetValue()


def test_unpacking_agrees_with_pylons_own() -> None:
    raw = np.random.default_rng(3).integers(0, 256, 9 * 16 * 3 // 2, np.uint8)
    source = pylon.PylonImage()
    source.AttachMemoryView(memoryview(raw.tobytes()), pylon.PixelType_Mono12p, 16, 9, 0)
    np.testing.assert_array_equal(unpack12(raw, 9, 16), source.GetArray())


@pytest.mark.parametrize(("options", "expected"), [({}, "Mono12"), ({"packed": True}, "Mono12p")])
def test_packed_pixels_are_a_choice(made: Make, options: dict[str, bool], expected: str) -> None:
    end = NodeCamera()
    camera = made(end, **options)
    camera.configure(CameraSettings(0.01, bits=12))
    assert value(end, "PixelFormat") == expected
    camera.configure(CameraSettings(0.01, bits=8))
    assert value(end, "PixelFormat") == "Mono8"


def test_packed_pixels_are_used_where_there_are_no_others(made: Make) -> None:
    end = but(PixelFormat=choice("PixelFormat", "Mono8", "Mono12p"))
    camera = made(end)
    assert camera.caps.bits == (8, 12)
    camera.configure(CameraSettings(0.01, bits=12))
    assert value(end, "PixelFormat") == "Mono12p"


def test_packed_pixels_that_are_not_there_are_refused(made: Make) -> None:
    camera = made(but(PixelFormat=choice("PixelFormat", "Mono8", "Mono12")), packed=True)
    with pytest.raises(SettingError, match="has no Mono12p"):
        camera.configure(CameraSettings(0.01, bits=12))


@pytest.mark.parametrize("margin", [0, 3])
def test_a_packed_frame(made: Make, margin: int) -> None:
    end = NodeCamera()
    pixels = np.random.default_rng(1).integers(0, 4096, (8, 64), np.uint16)
    rows = np.pad(packed(pixels).reshape(8, -1), [(0, 0), (0, margin)], constant_values=255)
    end.results.append(Result(rows, 64, 8, pylon.PixelType_Mono12p, 0, 1_500_000_000))
    camera = made(end, packed=True)
    camera.configure(CameraSettings(0.01, bits=12))
    frame = camera.snap()
    np.testing.assert_array_equal(frame.image, pixels)
    assert frame.device_time_s == 1.5
    assert end.triggers == 1


def test_rows_with_a_margin(made: Make) -> None:
    end = NodeCamera()
    buffer = np.random.default_rng(1).integers(0, 4096, (8, 66), np.uint16)
    end.results.append(Result(buffer, 64, 8, pylon.PixelType_Mono12, 0))
    camera = made(end)
    camera.configure(CameraSettings(0.01, bits=12))
    frame = camera.snap()
    np.testing.assert_array_equal(frame.image, buffer[:, :64])
    assert frame.device_time_s is None, "a time stamp of 0 is none"


def test_a_clock_with_its_own_ticks(made: Make) -> None:
    end = but(GevTimestampTickFrequency=integer("GevTimestampTickFrequency", 125_000_000, 0, 1 << 40))
    end.results.append(grey(0, ticks=250_000_000))
    camera = made(end)
    camera.configure(CameraSettings(0.01))
    assert camera.snap().device_time_s == 2.0


@pytest.mark.parametrize(
    "name", ["ResultingFrameRate", "BslResultingAcquisitionFrameRate", "ResultingFrameRateAbs"]
)
def test_the_resulting_frame_rate_tells_how_soon_a_trigger_is_taken(made: Make, name: str) -> None:
    end = but(**{name: number(name, 16.0, 0.0, 1e5)})
    camera = made(end)
    assert camera.caps.period_s == 1 / 16
    end.map.GetNode(name).SetValue(12.5)
    camera.configure(CameraSettings(0.01))
    assert camera.caps.period_s == 0.08


@pytest.mark.parametrize("end", [NodeCamera(), but(ResultingFrameRate=number("ResultingFrameRate", 0, 0, 9))])
def test_a_camera_that_does_not_tell_its_frame_rate(made: Make, end: NodeCamera) -> None:
    assert made(end).caps.period_s is None


def grey(block_id: int, width: int = 64, ticks: int = 0) -> Result:
    return Result(np.zeros((8, width), np.uint8), width, 8, pylon.PixelType_Mono8, block_id, ticks)


@pytest.mark.parametrize(
    ("device_class", "counted"),
    [("BaslerUsb", [0, 1, 2]), ("BaslerGigE", [1, 2, 3]), ("BaslerUsb", [(1 << 64) - 1] * 3)],
)
def test_frames_are_counted_as_the_link_counts(made: Make, device_class: str, counted: list[int]) -> None:
    end = NodeCamera(device_class=device_class)
    end.results.extend(grey(block_id) for block_id in counted)
    camera = made(end)
    camera.configure(CameraSettings(0.01))
    camera.arm(3)
    assert [camera.read(1.0).index for _ in range(3)] == [0, 1, 2]


@pytest.mark.parametrize(
    ("device_class", "counted"),
    [("BaslerUsb", [1]), ("BaslerUsb", [0, 2]), ("BaslerUsb", [0, 0]), ("BaslerGigE", [2])],
)
def test_a_gap_in_the_count_is_a_lost_frame(made: Make, device_class: str, counted: list[int]) -> None:
    end = NodeCamera(device_class=device_class)
    end.results.extend(grey(block_id) for block_id in counted)
    camera = made(end)
    camera.configure(CameraSettings(0.01))
    camera.arm(3)
    for _ in counted[1:]:
        camera.read(1.0)
    with pytest.raises(FrameLossError, match="arrived instead of"):
        camera.read(1.0)
    assert camera.state is State.FAULT
    assert not end.grabbing


def test_an_empty_frame_of_a_dying_link_is_refused(made: Make) -> None:
    end = NodeCamera()
    end.results.append(Result(np.zeros((1, 64), np.uint8), 64, 1, pylon.PixelType_Mono8, 0))
    camera = made(end)
    camera.configure(CameraSettings(0.01))
    with pytest.raises(FrameLossError, match=r"frame 0 is an array \(1, 64\) of uint8; \(8, 64\)"):
        camera.snap()


@pytest.mark.parametrize(
    ("roi", "complaint"),
    [
        ([0, 0, 40, 8], "Width is 40; the camera takes 16 to 64 in steps of 16"),
        ([0, 0, 80, 8], "Width is 80; the camera takes 16 to 64 in steps of 16"),
        ([0, 0, 16, 3], "Height is 3; the camera takes 2 to 8 in steps of 2"),
        ([8, 0, 16, 8], "OffsetX is 8; the camera takes 0 to 48 in steps of 16"),
        ([0, 8, 16, 2], "OffsetY is 8; the camera takes 0 to 6 in steps of 2"),
    ],
)
def test_an_roi_off_the_cameras_grid_is_refused(made: Make, roi: list[int], complaint: str) -> None:
    with pytest.raises(SettingError, match=complaint):
        made(NodeCamera(), roi=roi)


def test_a_rolling_shutter_is_known(made: Make) -> None:
    assert made(NodeCamera()).caps.readout_s == pytest.approx(0.054321)


@pytest.mark.parametrize(
    ("shutter", "expected", "readout_s", "dark_s"),
    [("rolling", "Rolling", 0.054321, 0.0), ("global_reset", "GlobalResetRelease", 0.0, 0.054321)],
)
def test_the_shutter_is_set(made: Make, shutter: str, expected: str, readout_s: float, dark_s: float) -> None:
    """Rows end one after another in both, but with a global reset they begin together."""
    end = NodeCamera()
    camera = made(end, shutter=shutter)
    assert value(end, "ShutterMode") == expected
    assert (camera.caps.readout_s, camera.caps.dark_s) == pytest.approx((readout_s, dark_s))


def test_a_shutter_that_is_not_there_is_refused(made: Make) -> None:
    with pytest.raises(SettingError, match="ShutterMode is Global; the camera takes one of Rolling"):
        made(NodeCamera(), shutter="global")


@pytest.mark.parametrize(
    ("shutter", "readout_s", "dark_s"),
    [
        ("global", 0.0, 0.0),
        ("rolling", 0.054321, 0.0),
        (None, 0.054321, 0.0),
        ("global_reset", 0.0, 0.054321),
    ],
)
def test_of_a_shutter_that_cannot_be_switched_the_rig_file_tells(
    made: Make, shutter: str | None, readout_s: float, dark_s: float
) -> None:
    caps = made(without("ShutterMode"), shutter=shutter).caps
    assert (caps.readout_s, caps.dark_s) == pytest.approx((readout_s, dark_s))


def test_a_shutter_that_can_be_global_is_at_once(made: Make) -> None:
    end = but(SensorShutterMode=choice("SensorShutterMode", "Global", "Rolling"))
    assert (made(end).caps.readout_s, made(end).caps.dark_s) == (0.0, 0.0)


def test_a_rolling_shutter_without_a_readout_time_is_refused(made: Make) -> None:
    with pytest.raises(CapabilityError, match="does not state its readout time"):
        made(without("SensorReadoutTime"))


def test_names_before_sfnc_2(made: Make) -> None:
    nodes = {name: node for name, node in ACE.items() if name not in ("ExposureTime", "SensorReadoutTime")}
    end = NodeCamera(
        {
            **nodes,
            "ExposureTimeAbs": number("ExposureTimeAbs", 1.0, 50.0, 1e6),
            "ReadoutTimeAbs": number("ReadoutTimeAbs", 2000.0, 0.0, 1e6),
        }
    )
    camera = made(end)
    assert camera.caps.exposure_s == (50e-6, 1.0)
    assert camera.caps.readout_s == pytest.approx(0.002)
    camera.configure(CameraSettings(0.02))
    assert value(end, "ExposureTimeAbs") == 20000.0


def test_of_two_names_that_of_sfnc_2_counts(made: Make) -> None:
    end = but(ExposureTimeAbs=number("ExposureTimeAbs", 1.0, 50.0, 1e6))
    camera = made(end)
    assert camera.caps.exposure_s == (19e-6, 10.0)
    camera.configure(CameraSettings(0.02))
    assert (value(end, "ExposureTime"), value(end, "ExposureTimeAbs")) == (20000.0, 1.0)


def test_a_camera_without_gain_takes_none(made: Make) -> None:
    camera = made(without("Gain"))
    assert camera.configure(CameraSettings(0.02)).gain_db == 0.0
    with pytest.raises(SettingError, match="gain_db is 1"):
        camera.configure(CameraSettings(0.02, gain_db=1.0))


def test_what_a_frame_must_not_contain_is_switched_off(made: Make) -> None:
    end = but(
        ExposureAuto=choice("ExposureAuto", "Continuous", "Off"),
        GainAuto=choice("GainAuto", "Continuous", "Once", "Off"),
        Gamma=number("Gamma", 0.45, 0.0, 4.0),
    )
    made(end)
    assert (value(end, "ExposureAuto"), value(end, "GainAuto"), value(end, "Gamma")) == ("Off", "Off", 1.0)


NOT_RAW: dict[str, tuple[Node, Any]] = {
    "AcquisitionFrameRateEnable": (switch("AcquisitionFrameRateEnable", True), False),
    "LUTEnable": (switch("LUTEnable", True), False),
    "DigitalShift": (integer("DigitalShift", 2, 0, 4), 0),
    "PgiMode": (choice("PgiMode", "On", "Off"), "Off"),
    "BslContrast": (number("BslContrast", 0.3, -1.0, 1.0), 0.0),
    "BinningHorizontal": (integer("BinningHorizontal", 2, 1, 4), 1),
    "BinningVertical": (integer("BinningVertical", 2, 1, 4), 1),
    "DecimationHorizontal": (integer("DecimationHorizontal", 2, 1, 4), 1),
    "DecimationVertical": (integer("DecimationVertical", 2, 1, 4), 1),
    "ReverseX": (switch("ReverseX", True), False),
    "ReverseY": (switch("ReverseY", True), False),
    "TestImageSelector": (choice("TestImageSelector", "Testimage1", "Off"), "Off"),
    "TestPattern": (choice("TestPattern", "Grey", "Off"), "Off"),
}


def test_every_sensor_pixel_comes_as_it_is(made: Make) -> None:
    end = but(**{name: node for name, (node, _) in NOT_RAW.items()})
    made(end)
    assert {name: value(end, name) for name in NOT_RAW} == {name: raw for name, (_, raw) in NOT_RAW.items()}


def test_what_cannot_be_made_raw_is_refused(made: Make) -> None:
    with pytest.raises(SettingError, match="BinningVertical is 2 and cannot be set to 1; frames would not"):
        made(but(BinningVertical=fixed("BinningVertical", 2)))
    made(but(BinningVertical=fixed("BinningVertical", 1)))


def test_a_gamma_that_is_switched_off_may_have_any_value(made: Make) -> None:
    end = but(GammaEnable=switch("GammaEnable", True), Gamma=number("Gamma", 0.45, 0.4, 0.5))
    made(end)
    assert value(end, "GammaEnable") is False
    with pytest.raises(SettingError, match=r"Gamma is 0\.45 and cannot be set to 1"):
        made(but(Gamma=number("Gamma", 0.45, 0.4, 0.5)))


def raw_gain(value: int = 400, least: int = 200) -> NodeCamera:
    """A camera of the ace classic GigE series: no gain in dB."""
    nodes = {name: node for name, node in ACE.items() if name not in ("Gain", "BlackLevel")}
    return NodeCamera(
        {
            **nodes,
            "GainSelector": choice("GainSelector", "DigitalAll", "All"),
            "GainRaw": integer("GainRaw", value, least, 1023),
            "BlackLevelRaw": integer("BlackLevelRaw", 32, 0, 255),
        }
    )


@pytest.mark.parametrize(
    ("conversion", "limits_db", "gain_db", "raw"),
    [
        ({"db_per_step": 0.0359}, (7.18, 36.7257), 10.0, 279),
        ({"unity": 32}, (15.9176, 30.0946), 20.0, 320),
    ],
)
def test_a_raw_gain_is_set_and_read_back_in_db(
    made: Make, conversion: dict[str, float], limits_db: tuple[float, float], gain_db: float, raw: int
) -> None:
    end = raw_gain()
    camera = made(end, raw_gain=conversion)
    assert camera.caps.gain_db == pytest.approx(limits_db, abs=1e-4)
    back = camera.configure(CameraSettings(0.02, gain_db))
    assert (value(end, "GainSelector"), value(end, "GainRaw")) == ("All", raw)
    assert back.gain_db == pytest.approx(gain_db, abs=0.02)
    with pytest.raises(SettingError, match="gain_db is 0 dB"):
        camera.configure(CameraSettings(0.02))


def test_a_raw_gain_whose_conversion_is_unknown_is_the_least(made: Make) -> None:
    end = raw_gain()
    camera = made(end)
    assert camera.caps.gain_db == (0.0, 0.0)
    assert camera.configure(CameraSettings(0.02)).gain_db == 0.0
    assert value(end, "GainRaw") == 200
    with pytest.raises(SettingError, match="gain_db is 6 dB"):
        camera.configure(CameraSettings(0.02, 6.0))


def test_a_raw_gain_of_0_has_no_db(made: Make) -> None:
    assert made(raw_gain(least=0), raw_gain={"unity": 32}).caps.gain_db[0] == pytest.approx(-30.103)


def test_a_gain_in_db_is_not_converted(made: Make) -> None:
    end = but(GainRaw=integer("GainRaw", 400, 200, 1023))
    assert made(end, raw_gain={"unity": 32}).configure(CameraSettings(0.02, 6.0)).gain_db == 6.0
    assert value(end, "GainRaw") == 400


@pytest.mark.parametrize("conversion", [{}, {"db_per_step": 0.0359, "unity": 32}])
def test_a_conversion_is_stated_in_one_way(made: Make, conversion: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match="either 'db_per_step' or 'unity'"):
        made(raw_gain(), raw_gain=conversion)


def test_a_raw_black_level(made: Make) -> None:
    end = raw_gain()
    made(end, black_level=64.0)
    assert value(end, "BlackLevelRaw") == 64
    with pytest.raises(SettingError, match=r"the camera takes whole numbers from 0 to 255"):
        made(raw_gain(), black_level=4.5)


LINE: dict[str, Node] = {
    "LineSelector": choice("LineSelector", "Line3", "Line1"),
    "LineMode": choice("LineMode", "Output", "Input"),
    "LineInverter": switch("LineInverter", True),
    "LineDebouncerTime": number("LineDebouncerTime", 500.0, 0.0, 20e3),
}


@pytest.mark.parametrize("debounce_us", [0.0, 12.0])
def test_the_line_is_an_input_that_is_neither_inverted_nor_slow(made: Make, debounce_us: float) -> None:
    end = but(**LINE)
    camera = made(end, trigger={"debounce_us": debounce_us})
    camera.configure(CameraSettings(0.01))
    camera.arm(1, "hardware")
    assert [value(end, name) for name in LINE] == ["Line1", "Input", False, debounce_us]


def test_a_line_that_cannot_be_an_input_or_be_debounced(made: Make) -> None:
    nodes = LINE | {"LineMode": choice("LineMode", "Output")}
    for end, found in (
        (but(**nodes), "LineMode is Output"),
        (without_debouncer(), "LineDebouncerTime cannot"),
    ):
        camera = made(end, trigger={"debounce_us": 12.0})
        camera.configure(CameraSettings(0.01))
        with pytest.raises((SettingError, CapabilityError), match=found):
            camera.arm(1, "hardware")


def without_debouncer() -> NodeCamera:
    return but(**{name: node for name, node in LINE.items() if name != "LineDebouncerTime"})


def test_the_black_level_is_set_or_refused(made: Make) -> None:
    end = NodeCamera()
    made(end, black_level=4.0)
    assert value(end, "BlackLevel") == 4.0
    with pytest.raises(SettingError, match="BlackLevel is 300; the camera takes 0 to 255"):
        made(NodeCamera(), black_level=300.0)
    with pytest.raises(CapabilityError, match="BlackLevel cannot be set"):
        made(without("BlackLevel"), black_level=4.0)


def test_the_line_its_edge_and_its_delay(made: Make) -> None:
    end = NodeCamera()
    camera = made(end, trigger={"line": "Line3", "edge": "falling", "delay_us": 12.5})
    camera.configure(CameraSettings(0.01))
    camera.arm(1, "hardware")
    names = ("TriggerMode", "TriggerSource", "TriggerActivation", "TriggerDelay")
    assert [value(end, name) for name in names] == ["On", "Line3", "FallingEdge", 12.5]
    camera.stop()
    camera.arm(1, "software")
    assert [value(end, name) for name in names[1:]] == ["Software", "FallingEdge", 0.0]


def test_an_output_that_is_active_during_exposures(made: Make) -> None:
    end = but(
        LineSelector=choice("LineSelector", "Line1", "Line2"),
        LineMode=choice("LineMode", "Input", "Output"),
        LineSource=choice("LineSource", "UserOutput1", "ExposureActive"),
    )
    assert made(end, strobe="Line2").caps.strobe
    lines = ("LineSelector", "LineMode", "LineSource")
    assert [value(end, name) for name in lines] == ["Line2", "Output", "ExposureActive"]
    assert not made(but()).caps.strobe
    with pytest.raises(SettingError, match=r"LineSelector is Line9; the camera takes one of Line1, Line2"):
        made(but(LineSelector=choice("LineSelector", "Line1", "Line2")), strobe="Line9")


def test_a_line_that_is_not_there(made: Make) -> None:
    with pytest.raises(SettingError, match=r"trigger\.line is Line2; the camera has Software, Line1, Line3"):
        made(NodeCamera(), trigger={"line": "Line2"})


def test_a_camera_that_cannot_say_when_it_is_ready_is_not_triggered(made: Make) -> None:
    end = NodeCamera()
    end.ready_is_known = False
    camera = made(end)
    camera.configure(CameraSettings(0.01))
    assert camera.caps.triggers == ()
    with pytest.raises(CapabilityError):
        camera.arm(1)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({}, "'serial' is missing"),
        ({"serial": 21734321}, "'serial' is 21734321"),
        ({"serial": SERIAL, "roi": [0, 0, 64]}, "'roi"),
        ({"serial": SERIAL, "roi": [-16, 0, 64, 8]}, "'roi"),
        ({"serial": SERIAL, "trigger": {"edge": "up"}}, "'trigger.edge' is 'up'"),
        ({"serial": SERIAL, "shutter": "slow"}, "'shutter' is 'slow'"),
        ({"serial": SERIAL, "sharpness": 3}, "unknown key 'sharpness'"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        BaslerCamera("camera", options)


def test_a_camera_that_states_its_speed_has_it_in_its_link(made: Make) -> None:
    slow = choice("BslUSBSpeedMode", "HighSpeed", "SuperSpeed")
    assert made(but(BslUSBSpeedMode=slow)).info().link.endswith("USB 2, 480 Mbit/s")
    assert "bit/s" not in made(NodeCamera(ACE)).info().link


def test_a_camera_with_a_bayer_filter_gives_its_raw_pixels(made: Make) -> None:
    """Mono8 of a colour camera is made of several pixels; white balance multiplies levels."""
    end = but(
        PixelFormat=choice("PixelFormat", "Mono8", "BayerRG8", "BayerRG12", "BayerRG12p", "RGB8"),
        BalanceRatioSelector=choice("BalanceRatioSelector", "Red", "Green", "Blue"),
        BalanceRatio=number("BalanceRatio", 1.7, 0.0, 8.0),
        BalanceWhiteAuto=choice("BalanceWhiteAuto", "Continuous", "Off"),
    )
    camera = made(end)
    assert (camera.caps.bayer, camera.caps.bits) == ("RGGB", (8, 12))
    assert (value(end, "BalanceRatio"), value(end, "BalanceWhiteAuto")) == (1.0, "Off")
    for bits, packed_pixels, expected in (
        (8, False, "BayerRG8"),
        (12, False, "BayerRG12"),
        (12, True, "BayerRG12p"),
    ):
        made(end, packed=packed_pixels).configure(CameraSettings(0.01, bits=bits))
        assert value(end, "PixelFormat") == expected


def test_a_white_balance_that_stays_is_refused(made: Make) -> None:
    end = but(
        BalanceRatioSelector=choice("BalanceRatioSelector", "Red"),
        BalanceRatio=number("BalanceRatio", 1.7, 1.5, 8.0),
    )
    with pytest.raises(SettingError, match=r"BalanceRatio is 1\.7 and cannot be set to 1"):
        made(end)
