"""The Basler driver on node maps of five cameras: configured, read back, and raw whatever was left behind."""

import logging
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pypylon import pylon

from drivers.basler import BaslerCamera
from drivers.basler.families import FAMILIES, family_of, raw_gain_of
from fpplab.core.errors import CapabilityError, FrameLossError, SettingError
from fpplab.devices import CameraSettings
from tests.drivers.basler_families import KINDS, Kind
from tests.drivers.node_camera import SERIAL, NodeCamera, NodeMap, Result, choice, fixed, integer, number

Open = Callable[..., BaslerCamera]


@pytest.fixture(params=KINDS)
def kind(request: pytest.FixtureRequest) -> Kind:
    return KINDS[request.param]


@pytest.fixture
def opened() -> Iterator[Open]:
    cameras: list[BaslerCamera] = []

    def make(kind: Kind, end: NodeCamera, **options: Any) -> BaslerCamera:
        section = {"serial": SERIAL, **kind.options, **options}
        camera = BaslerCamera("camera", section, SimpleNamespace(pylon=end))
        cameras.append(camera)
        camera.open()
        return camera

    yield make
    for camera in cameras:
        camera.close()


def value(end: NodeCamera, name: str) -> Any:
    return end.map.GetNode(name).GetValue()


def test_all_that_is_not_raw_is_switched_off(opened: Open, kind: Kind) -> None:
    end = kind.camera()
    assert all(value(end, name) != raw for name, (_, raw) in kind.wrong.items())
    opened(kind, end)
    assert {name: value(end, name) for name in kind.wrong} == {n: raw for n, (_, raw) in kind.wrong.items()}


def test_each_that_stays_is_refused_by_name(opened: Open, kind: Kind) -> None:
    for name, (node, raw) in kind.wrong.items():
        stays = (node[0], node[1].replace("<Value>", "<ImposedAccessMode>RO</ImposedAccessMode><Value>", 1))
        if node[0] == "Enum":
            found = value(kind.camera(), name)
            stays = choice(name, found)
        with pytest.raises(SettingError, match=f"{name} is .* and cannot be set to {str(raw).split('.')[0]}"):
            opened(kind, kind.camera(**{name: stays}))


def test_6_db_amplify_twofold(opened: Open, kind: Kind) -> None:
    end = kind.camera()
    camera = opened(kind, end)
    back = camera.configure(CameraSettings(0.02, gain_db=6.0, bits=12))
    assert kind.factor(value(end, kind.gain)) == pytest.approx(10 ** (6 / 20), rel=0.005)
    assert back.gain_db == pytest.approx(20 * np.log10(kind.factor(value(end, kind.gain))), abs=1e-9)
    assert value(end, "GainSelector") == value(end, "BlackLevelSelector") == "All"


def test_the_range_of_gains_is_that_of_its_node(opened: Open, kind: Kind) -> None:
    end = kind.camera()
    node = end.map.GetNode(kind.gain)
    least, most = (20 * np.log10(kind.factor(raw)) for raw in (node.GetMin(), node.GetMax()))
    camera = opened(kind, end)
    assert camera.caps.gain_db == pytest.approx((least, most), abs=0.04)
    with pytest.raises(SettingError, match="gain_db"):
        camera.configure(CameraSettings(0.02, gain_db=most + 0.1))


def test_settings_are_those_of_the_camera(opened: Open, kind: Kind) -> None:
    end = kind.camera()
    camera = opened(kind, end, black_level=20)
    assert camera.configure(CameraSettings(0.0125, gain_db=6.0, bits=12)).exposure_s == 0.0125
    assert value(end, kind.exposure) == 12500.0
    assert value(end, kind.black_level) == 20
    assert value(end, "PixelFormat") == "Mono12"
    assert camera.caps.period_s == pytest.approx(1 / (25 if "Abs" in kind.exposure else 60))


def test_the_whole_sensor_or_a_region_on_the_cameras_grid(opened: Open, kind: Kind) -> None:
    end = kind.camera()
    whole = tuple(int(end.map.GetNode(name).GetMax()) for name in ("Width", "Height"))
    assert opened(kind, end).caps.size == whole
    step, step_y = (int(end.map.GetNode(name).GetInc()) for name in ("Width", "Height"))
    roi = [2 * step, 3 * step_y, 8 * step, 6 * step_y]
    assert opened(kind, end, roi=roi).caps.size == tuple(roi[2:])
    assert [value(end, name) for name in ("OffsetX", "OffsetY", "Width", "Height")] == roi
    with pytest.raises(
        SettingError, match=f"Width is {8 * step + 1}; the camera takes .* in steps of {step}"
    ):
        opened(kind, end, roi=[0, 0, 8 * step + 1, 6 * step_y])
    with pytest.raises(SettingError, match=f"OffsetX is {step + 1}; .* in steps of {step}"):
        opened(kind, end, roi=[step + 1, 0, 8 * step, 6 * step_y])


def test_the_line_is_a_plain_input(opened: Open, kind: Kind) -> None:
    end = kind.camera()
    camera = opened(kind, end, trigger={"debounce_us": 5.0})
    camera.configure(CameraSettings(0.02, gain_db=6.0))
    camera.arm(1, "hardware")
    names = (
        "TriggerSelector",
        "TriggerMode",
        "TriggerSource",
        "TriggerActivation",
        "LineSelector",
        "LineMode",
    )
    assert [value(end, n) for n in names] == ["FrameStart", "On", "Line1", "RisingEdge", "Line1", "Input"]
    assert (value(end, "LineInverter"), value(end, kind.debouncer), value(end, kind.delay)) == (
        False,
        5.0,
        0.0,
    )


def test_packets_are_a_matter_of_ethernet(opened: Open, kind: Kind) -> None:
    end, packets = kind.camera(), {"packet_bytes": 8192, "packet_delay_ticks": 1000}
    if kind.device_class == "BaslerGigE":
        opened(kind, end, **packets)
        assert (value(end, "GevSCPSPacketSize"), value(end, "GevSCPD")) == (8192, 1000)
        with pytest.raises(SettingError, match=r"GevSCPSPacketSize is 8193; .* in steps of 4"):
            opened(kind, end, packet_bytes=8193)
    else:
        with pytest.raises(CapabilityError, match="GevSCPSPacketSize cannot be set to 8192"):
            opened(kind, end, **packets)


def test_a_model_has_all_nodes_of_its_family(
    opened: Open, kind: Kind, caplog: pytest.LogCaptureFixture
) -> None:
    opened(kind, kind.camera())
    assert not caplog.records
    nodes = {name: node for name, node in kind.nodes.items() if name != kind.debouncer}
    with caplog.at_level(logging.WARNING):
        opened(kind, Kind(**{**vars(kind), "nodes": nodes}).camera())
    assert f"{kind.model} has no {kind.debouncer}, which" in caplog.text


def test_models_belong_to_one_family() -> None:
    assert len({family_of(model) for model in KINDS}) == len(FAMILIES) == 4
    assert family_of("daA1280-54um") is None
    assert [raw_gain_of(m) is None for m in (*KINDS, "acA1300-60gm")] == [
        False,
        False,
        True,
        True,
        True,
        True,
    ]


def test_a_stated_conversion_counts_before_a_known_one(opened: Open) -> None:
    kind = KINDS["acA2040-25gm"]
    end = kind.camera()
    camera = opened(kind, end, raw_gain={"unity": 64})
    camera.configure(CameraSettings(0.02, gain_db=6.0))
    assert value(end, "GainRaw") == 128


def test_a_model_whose_gain_is_unknown_takes_the_least(opened: Open) -> None:
    kind = Kind(**{**vars(KINDS["acA2040-25gm"]), "model": "acA1300-60gm"})
    end = kind.camera()
    opened(kind, end).configure(CameraSettings(0.02))
    assert value(end, "GainRaw") == 36
    with pytest.raises(SettingError, match="gain_db is 6 dB"):
        opened(kind, end).configure(CameraSettings(0.02, 6.0))


def test_the_readout_and_the_reset_of_rows(opened: Open) -> None:
    rolling = KINDS["acA5472-17um"]
    assert opened(rolling, rolling.camera()).caps.readout_s == pytest.approx(0.014)
    assert opened(rolling, rolling.camera(), shutter="global_reset").caps.dark_s == pytest.approx(0.014)
    fast = KINDS["a2A1920-160umPRO"]
    assert opened(fast, fast.camera()).caps.readout_s == 0.0
    assert opened(fast, fast.camera(), shutter="rolling").caps.readout_s == pytest.approx(0.014)


LINK = {
    "Statistic_Failed_Packet_Count": 3,
    "Statistic_Resend_Packet_Count": 12,
    "Statistic_Failed_Buffer_Count": 0,
}


def with_losses(**counts: int) -> NodeCamera:
    end = NodeCamera()
    end.link = NodeMap({name: fixed(name, count) for name, count in counts.items()})
    return end


def frame(arrived: bool) -> Result:
    result = Result(np.zeros((8, 64), np.uint8), 64, 8, pylon.PixelType_Mono8, 0)
    if not arrived:
        result.GrabSucceeded = lambda: False  # type: ignore[method-assign]
        result.GetErrorDescription = lambda: "incomplete"  # type: ignore[attr-defined]
        result.GetErrorCode = lambda: 0xE1000014  # type: ignore[attr-defined]
    return result


def armed(end: NodeCamera, frames: int = 1) -> BaslerCamera:
    camera = BaslerCamera("camera", {"serial": SERIAL}, SimpleNamespace(pylon=end))
    camera.open()
    camera.configure(CameraSettings(0.01))
    camera.arm(frames)
    return camera


def test_a_damaged_frame_tells_what_the_link_lost() -> None:
    end = with_losses(**LINK)
    end.results.append(frame(arrived=False))
    with pytest.raises(
        FrameLossError, match=r"incomplete \(0xe1000014\), 3 packets lost, 12 packets sent again;"
    ):
        armed(end).read(1.0)


@pytest.mark.parametrize(("resent", "warnings"), [(12, 1), (0, 0)])
def test_packets_sent_again_are_warned_of(
    resent: int, warnings: int, caplog: pytest.LogCaptureFixture
) -> None:
    end = with_losses(Statistic_Resend_Packet_Count=resent)
    end.results.append(frame(arrived=True))
    armed(end).read(1.0)
    assert len(caplog.records) == warnings
    assert ("12 packets sent again" in caplog.text) == bool(warnings)
    assert ("packet_delay_ticks" in caplog.text) == bool(warnings)


def test_a_link_that_does_not_count_lost_nothing() -> None:
    end = NodeCamera()
    end.results.append(frame(arrived=False))
    with pytest.raises(FrameLossError, match=r"incomplete \(0xe1000014\);"):
        armed(end).read(1.0)


def test_a_gain_off_the_cameras_steps_is_read_back(opened: Open) -> None:
    kind = KINDS["acA750-30gm"]
    end = kind.camera(GainRaw=integer("GainRaw", 100, 0, 1023))
    back = opened(kind, end).configure(CameraSettings(0.02, gain_db=6.0))
    assert value(end, "GainRaw") == 167
    assert back.gain_db == pytest.approx(167 * 0.0359)


def test_a_black_level_out_of_range_is_refused(opened: Open) -> None:
    kind = KINDS["acA750-30gm"]
    with pytest.raises(SettingError, match="BlackLevelRaw is 64; the camera takes 0 to 63"):
        opened(kind, kind.camera(), black_level=64)
    fine = KINDS["acA5472-17um"]
    end = fine.camera(BlackLevel=number("BlackLevel", 8.0, 0.0, 63.75))
    opened(fine, end, black_level=4.25)
    assert value(end, "BlackLevel") == 4.25
