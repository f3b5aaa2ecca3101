"""Cameras of six makers behind GenTL: raw, read back, and triggered no faster than they say."""

from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from drivers import computer_settings
from drivers.gentl import GentlCamera
from drivers.gentl.makers import MAKERS, maker_of
from drivers.gentl.producer import IncompleteBufferError
from fpplab.acquisition.timing import pulse_timing
from fpplab.core.errors import FrameLossError, SettingError
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern
from tests.conformance.gentl_end import SERIAL, ScriptedProducer
from tests.conformance.reference import PROJECTOR_SIZE, ReferenceBench, ReferenceProjector
from tests.drivers.maker_cameras import CAMERAS, MakerEnd

WHITE = Pattern(image=np.full(PROJECTOR_SIZE[::-1], 255, np.uint8), id="white", bit_depth=8)
BITS = 12
Open = Callable[..., tuple[GentlCamera, MakerEnd, ReferenceBench]]


@pytest.fixture
def opened() -> Iterator[Open]:
    cameras: list[GentlCamera] = []

    def make(
        maker: str, prepare: Callable[[MakerEnd], None] = lambda end: None, **options: Any
    ) -> tuple[GentlCamera, MakerEnd, ReferenceBench]:
        bench = ReferenceBench({})
        bench.open()
        end = MakerEnd(bench, CAMERAS[maker])
        prepare(end)
        section = {"producer": "maker.cti", "serial": SERIAL, **options}
        camera = GentlCamera("camera", section, SimpleNamespace(gentl=lambda path: ScriptedProducer(end)))
        cameras.append(camera)
        camera.open()
        return camera, end, bench

    yield make
    for camera in cameras:
        camera.close()


def test_each_maker_is_recognised_by_its_vendors_name() -> None:
    assert {maker_of(camera.vendor).vendors for camera in CAMERAS.values()} == {m.vendors for m in MAKERS}
    assert maker_of("Teledyne FLIR") is maker_of("Point Grey Research") is MAKERS[0]
    assert maker_of("nobody").raw == ()


@pytest.mark.parametrize("maker", CAMERAS)
def test_settings_are_read_back_and_frames_are_raw(opened: Open, maker: str) -> None:
    camera, end, bench = opened(maker)
    assert {name: end.value(name) for name in end.camera.raw} == {
        name: neutral for name, (_, neutral) in end.camera.raw.items() if neutral is not None
    }
    wanted = CameraSettings(0.02, 6.0, BITS)
    back = camera.configure(wanted)
    assert back.exposure_s == 0.02
    assert back.gain_db == pytest.approx(6.0, abs=1e-6)
    camera.configure(CameraSettings(0.02, 0.0, BITS))
    bench.on_show = WHITE
    assert camera.snap().image.mean() / (1 << BITS) == pytest.approx(0.72, abs=0.01)


@pytest.mark.parametrize("maker", CAMERAS)
def test_both_triggers_expose(opened: Open, maker: str) -> None:
    camera, end, bench = opened(maker)
    camera.configure(CameraSettings(0.02, bits=BITS))
    assert camera.caps.triggers == ("software", "hardware")
    bench.on_show = WHITE
    camera.arm(2)
    assert [camera.read(1.0).index for _ in range(2)] == [0, 1]
    camera.arm(3, "hardware")
    bench.pulses.extend([WHITE] * 3)
    assert [camera.read(1.0).index for _ in range(3)] == [0, 1, 2]
    assert end.lost == 0


@pytest.mark.parametrize("exposure_s", [0.001, 0.00594, 0.02])
@pytest.mark.parametrize("maker", CAMERAS)
def test_pulses_are_no_closer_than_the_camera_takes_them(opened: Open, maker: str, exposure_s: float) -> None:
    camera, end, bench = opened(maker)
    back = camera.configure(CameraSettings(exposure_s, bits=BITS))
    projector = ReferenceProjector("projector", {}, bench)
    projector.open()
    one_bit = [Pattern(image=WHITE.image, id="white", bit_depth=1)]
    timing = pulse_timing(camera, projector, one_bit, back.exposure_s)
    assert timing.period_s >= end.interval_s
    assert timing.period_s < end.interval_s + exposure_s + 0.001, "nor are they needlessly far apart"


@pytest.mark.parametrize("maker", ["flir", "jai"])
def test_triggers_overlap_the_readout_where_they_can(opened: Open, maker: str) -> None:
    _, end, _ = opened(maker)
    assert end.value("TriggerOverlapFrameStart") == "ReadOut"


def test_a_bayer_camera_says_which_colours_its_pixels_see(opened: Open) -> None:
    camera, _, _ = opened("daheng")
    assert (camera.caps.bayer, camera.caps.bits) == ("RGGB", (8, 12))


def test_the_step_of_exposures_is_that_of_sensor_rows(opened: Open) -> None:
    def in_rows(end: MakerEnd) -> None:
        own = end._node

        def node(name: str) -> Any:
            found = own(name)
            if name == "ExposureTime":
                found.HasInc, found.GetInc = lambda: True, lambda: 14.8
            return found

        end._node = node  # type: ignore[method-assign]

    assert opened("ids", in_rows)[0].caps.exposure_step_s == pytest.approx(14.8e-6)
    assert opened("ids")[0].caps.exposure_step_s == 0.0


def test_the_gain_of_the_digital_part_is_switched_off_and_the_sensors_own_is_set(opened: Open) -> None:
    camera, end, _ = opened("ids")
    camera.configure(CameraSettings(0.02, 12.0, BITS))
    assert end.value("GainDigitalAll") == 1.0
    assert end.value("GainAnalogAll") == pytest.approx(10 ** (12.0 / 20.0))


def keeps_blemishes(end: MakerEnd) -> None:
    own = end._node

    def fixed_node(name: str) -> Any:
        node = own(name)
        return (
            SimpleNamespace(
                IsValid=lambda: True,
                IsReadable=lambda: True,
                IsWritable=lambda: False,
                GetValue=node.GetValue,
            )
            if name == "BlemishEnable"
            else node
        )

    end._node = fixed_node  # type: ignore[method-assign]


def test_what_a_camera_keeps_is_refused_or_accepted_by_name(
    opened: Open, caplog: pytest.LogCaptureFixture
) -> None:
    with pytest.raises(
        SettingError, match=r"BlemishEnable is True .*accept it by `accept_raw: \[BlemishEnable\]`"
    ):
        opened("jai", keeps_blemishes)
    with pytest.raises(SettingError, match="BlemishEnable is True"):
        opened("jai", keeps_blemishes, accept_raw=["ShadingMode"])
    opened("jai", keeps_blemishes, accept_raw=["BlemishEnable"])
    assert "BlemishEnable is True and cannot be set to False; the rig file accepts it" in caplog.text


def test_a_line_that_the_camera_has_not_is_refused_by_name(opened: Open) -> None:
    with pytest.raises(SettingError, match=r"trigger\.line is Line9; the camera has Line0, Software"):
        opened("flir", trigger={"line": "Line9"})


@pytest.mark.parametrize(
    ("link", "cause"),
    [
        ("GenTL U3V", "; little memory; give it more"),
        ("GenTL GEV", "; full sockets; give them more"),
        ("GenTL CL", "; check the cable"),
    ],
)
def test_a_damaged_frame_is_told_at_once_as_what_it_is(
    opened: Open, monkeypatch: pytest.MonkeyPatch, link: str, cause: str
) -> None:
    camera, end, _ = opened("flir")
    camera.configure(CameraSettings(0.02, bits=BITS))
    camera.arm(2)

    def fetch(timeout_s: float) -> None:
        raise IncompleteBufferError

    end.fetch = fetch  # type: ignore[method-assign, assignment]
    end.link = link
    monkeypatch.setattr(computer_settings, "usb_memory", lambda: "computer: little memory; give it more")
    monkeypatch.setattr(computer_settings, "full_sockets", lambda: "computer: full sockets; give them more")
    with pytest.raises(FrameLossError, match=f"frame 0 is damaged: only a part of its data came{cause}"):
        camera.read(60.0)
