"""The driver of GenTL cameras, on a scripted camera and on a real producer without a sensor."""

import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import genicam
import numpy as np
import pytest
from genicam import gentl
from harvesters.core import Callback, ImageAcquirer

from drivers.gentl import GentlCamera
from drivers.gentl.producer import GentlEnd, GentlFrame, GentlProducer, IncompleteBufferError
from fpplab.core.errors import (
    CapabilityError,
    ConfigError,
    DisconnectedError,
    FrameLossError,
    SettingError,
    StateError,
)
from fpplab.devices import CameraSettings, State
from tests.conformance.gentl_end import SERIAL, SFNC, ScriptedEnd, ScriptedProducer
from tests.conformance.reference import ReferenceBench
from tests.drivers.node_camera import Node, choice, number

VIKY = Path(genicam.__file__).with_name("viky.cti")
"""The GenTL producer of the `genicam` package: a game, whose pictures are frames."""
SETTINGS = CameraSettings(0.01, bits=12)

Open = Callable[..., tuple[GentlCamera, ScriptedEnd]]


@pytest.fixture
def opened() -> Iterator[Open]:
    cameras: list[GentlCamera] = []

    def make(
        nodes: dict[str, Node] = SFNC, tells_status: bool = True, **options: Any
    ) -> tuple[GentlCamera, ScriptedEnd]:
        bench = ReferenceBench({})
        bench.open()
        end = ScriptedEnd(bench, nodes)
        end.tells_status = tells_status
        section = {"producer": "maker.cti", "serial": SERIAL, **options}
        camera = GentlCamera("camera", section, SimpleNamespace(gentl=lambda path: ScriptedProducer(end)))
        cameras.append(camera)
        camera.open()
        return camera, end

    yield make
    for camera in cameras:
        camera.close()


def test_what_another_program_left_is_made_raw(opened: Open) -> None:
    camera, end = opened({**SFNC, "Gamma": number("Gamma", 0.45, 0.0, 4.0)})
    assert (end.value("ExposureAuto"), end.value("Gamma")) == ("Off", 1.0)
    assert camera.caps.size == (48, 32)
    assert camera.caps.bits == (8, 12)
    assert camera.caps.period_s == 0.001


@pytest.mark.parametrize("trigger", ["software", "hardware"])
@pytest.mark.parametrize("tells_status", [True, False])
def test_an_armed_camera_is_ready(opened: Open, trigger: Any, tells_status: bool) -> None:
    camera, end = opened(tells_status=tells_status)
    camera.configure(SETTINGS)
    camera.arm(2, trigger)
    end.trigger("Line1" if trigger == "hardware" else "Software", None)
    assert (end.lost, end.triggers) == (0, 1)
    assert camera.read(1.0).index == 0


def test_a_frame_lost_on_the_way_is_missing_from_the_count(opened: Open) -> None:
    camera, end = opened()
    camera.configure(SETTINGS)
    camera.arm(2)
    end.triggers = 1  # the first frame went astray
    with pytest.raises(FrameLossError, match="frame 1 arrived instead of frame 0"):
        camera.read(1.0)
    assert camera.state is State.FAULT
    assert not end.started


def test_of_a_layer_that_begins_as_it_likes_the_first_number_counts(opened: Open) -> None:
    camera, end = opened()
    end.first_number = None  # type: ignore[assignment]
    camera.configure(SETTINGS)
    camera.arm(2)
    end.triggers = 41
    assert [camera.read(1.0).index for _ in range(2)] == [0, 1]


@pytest.mark.parametrize(("layer", "first"), [("U3V", 0), ("GEV", 1), ("Custom", None)])
def test_layers_begin_to_count_differently(layer: str, first: int | None) -> None:
    info = SimpleNamespace(vendor="maker", model="one", tl_type=layer)
    assert GentlEnd(Acquirer(), info).first_number == first


class Acquirer:
    """An `ImageAcquirer` of harvesters, whose buffers come incomplete."""

    Events = ImageAcquirer.Events

    def add_callback(self, event: Any, callback: Callback) -> None:
        assert event == self.Events.INCOMPLETE_BUFFER
        self._callback = callback

    def try_fetch(self, timeout: float, is_raw: bool) -> None:
        self._callback.emit(self)


def test_an_incomplete_buffer_is_told_from_none() -> None:
    end = GentlEnd(Acquirer(), SimpleNamespace(vendor="maker", model="one", tl_type="GEV"))
    with pytest.raises(IncompleteBufferError):
        end.fetch(60.0)


def test_pixels_that_are_left_justified_are_refused(opened: Open) -> None:
    camera, end = opened()
    camera.configure(SETTINGS)
    camera.arm(1)
    end._seen.append(GentlFrame(np.full((32, 48), 4096, np.uint16), 1, None))
    with pytest.raises(FrameLossError, match="levels of more than 12 bits"):
        camera.read(1.0)


def test_a_gain_that_is_not_in_db_needs_its_conversion(opened: Open) -> None:
    nodes = {**SFNC, "Gain": number("Gain", 3.0, 1.0, 16.0)}
    camera, end = opened(nodes)
    assert camera.caps.gain_db == (0.0, 0.0)
    camera.configure(SETTINGS)
    assert end.value("Gain") == 1.0
    camera, end = opened(nodes, raw_gain={"unity": 1})
    assert camera.caps.gain_db == pytest.approx((0.0, 24.08), abs=0.01)
    assert camera.configure(CameraSettings(0.01, 6.0, 12)).gain_db == pytest.approx(6.0)
    assert end.value("Gain") == pytest.approx(10 ** (6 / 20))


def test_a_camera_without_raw_pixels_is_refused(opened: Open) -> None:
    nodes = {**SFNC, "PixelFormat": choice("PixelFormat", "RGB8", "YUV422_8")}
    with pytest.raises(CapabilityError, match="its pixel formats are RGB8, YUV422_8"):
        opened(nodes)


def test_an_automatic_exposure_that_stays_is_refused(opened: Open) -> None:
    with pytest.raises(SettingError, match="ExposureAuto is Continuous and cannot be set to Off"):
        opened({**SFNC, "ExposureAuto": choice("ExposureAuto", "Continuous")})


def test_a_camera_that_is_not_there_or_goes(opened: Open) -> None:
    with pytest.raises(DisconnectedError, match="no camera with the serial number G-2; there is G-1"):
        opened(serial="G-2")
    camera, _ = opened()
    camera._producer.connected.clear()
    camera.configure(SETTINGS)
    camera.arm(1, "hardware")
    with pytest.raises(DisconnectedError, match="unplugged"):
        camera.read(0.01)


def test_a_camera_in_use(opened: Open, monkeypatch: pytest.MonkeyPatch) -> None:
    def attach(self: Any, info: Any) -> None:
        with GentlViky() as producer:
            viky = producer.cameras()["1"]
            first = producer.attach(viky)
            try:
                producer.attach(viky)
            finally:
                first.close()

    monkeypatch.setattr(ScriptedProducer, "attach", attach)
    with pytest.raises(StateError, match="another program has the camera open"):
        opened()


class GentlViky:
    """The real producer, closed in the end."""

    def __enter__(self) -> GentlProducer:
        self._producer = GentlProducer(VIKY)
        return self._producer

    def __exit__(self, *_: object) -> None:
        self._producer.close()


def test_a_real_producer_lists_its_cameras_by_serial_number() -> None:
    with GentlViky() as producer:
        assert list(producer.cameras()) == ["0", "1", "2"]


def test_a_real_producers_frames_are_numbered_and_of_the_size_that_is_set() -> None:
    own = signal.getsignal(signal.SIGINT)
    with GentlViky() as producer:
        end = producer.attach(producer.cameras()["2"])
        assert signal.getsignal(signal.SIGINT) is own
        nodes = end.GetNodeMap()
        nodes.GetNode("PixelFormat").SetValue("Mono8")
        nodes.GetNode("Width").SetValue(320)
        nodes.GetNode("AcquisitionFrameRate").SetValue(50.0)
        for _ in range(2):
            end.start(1)
            frames = [end.fetch(5.0) for _ in range(12)]
            end.stop()
            numbers = [frame.number for frame in frames if frame]
            assert len(numbers) == 12, "a buffer was not given back"
            assert numbers[0] == 1
            assert numbers == sorted(set(numbers)), "the producer may lose frames, but not their order"
            assert {frame.image.shape for frame in frames if frame} == {(400, 320)}
            assert {frame.image.dtype for frame in frames if frame} == {np.dtype(np.uint8)}
            assert not any(np.shares_memory(frames[0].image, frame.image) for frame in frames[1:] if frame)
        end.start(1)
        end.stop()
        end.close()


def test_a_real_producers_camera_whose_exposure_is_its_own_is_refused() -> None:
    camera = GentlCamera("camera", {"producer": str(VIKY), "serial": "0"})
    with pytest.raises(CapabilityError, match="Viky has neither ExposureTime nor"):
        camera.open()
    with pytest.raises(DisconnectedError, match="there is 0, 1, 2"):
        GentlCamera("camera", {"producer": str(VIKY), "serial": "7"}).open()


def test_a_producer_that_is_not_there_or_none(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="there is no such GenTL producer"):
        GentlCamera("camera", {"producer": str(tmp_path / "none.cti"), "serial": "0"}).open()
    (tmp_path / "wrong.cti").write_bytes(b"no library")
    with pytest.raises(ConfigError, match="cannot be loaded as a GenTL producer"):
        GentlCamera("camera", {"producer": str(tmp_path / "wrong.cti"), "serial": "0"}).open()


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    import drivers.gentl

    monkeypatch.setitem(sys.modules, "genicam", None)
    for name in ("camera", "nodes", "producer"):
        monkeypatch.delitem(sys.modules, f"drivers.gentl.{name}")
        monkeypatch.delattr(drivers.gentl, name)
    with pytest.raises(ImportError, match="genicam is not installed; install it with: pip"):
        drivers.gentl.GentlCamera  # noqa: B018 - it is imported when it is named


def test_harvesters_errors_are_those_that_are_translated() -> None:
    assert issubclass(gentl.ResourceInUseException, gentl.GenericException)
