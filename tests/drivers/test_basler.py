"""The Basler driver on pylon's own camera emulator: opening, settings, frames, files."""

import gc
import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pypylon import genicam, pylon

from drivers.basler import BaslerCamera
from drivers.genicam import buffers
from fpplab.core.conventions import raw_dtype
from fpplab.core.errors import (
    CapabilityError,
    ConfigError,
    DeviceError,
    DeviceTimeoutError,
    DisconnectedError,
    SettingError,
    StateError,
)
from fpplab.devices import CameraSettings, Frame, State
from tests.drivers.basler_bench import (
    SERIAL,
    SETTINGS,
    SIZE,
    SOON_S,
    Counter,
    assert_mended,
    driver,
    end,
    shade,
)
from tests.support.pulsed_pylon import PulsedCamera, PulsedPylon

# Opening


def test_an_unknown_serial_number_names_those_that_are_there(bench: PulsedPylon) -> None:
    camera = driver(bench, serial="4711")
    with pytest.raises(DisconnectedError, match="serial number 4711 is connected; there is 0815-0000"):
        camera.open()
    assert camera.state is State.CLOSED


def test_no_camera_at_all(bench: PulsedPylon) -> None:
    bench.unplug()
    with pytest.raises(DisconnectedError, match="there is none"):
        driver(bench).open()


def test_the_serial_number_tells_cameras_apart() -> None:
    bench = PulsedPylon(cameras=2)
    bench.start()
    try:
        with driver(bench, serial="0815-0001") as second, driver(bench) as first:
            assert (first.info().serial, second.info().serial) == ("0815-0000", "0815-0001")
    finally:
        bench.close()


def test_a_camera_that_another_program_has(camera: BaslerCamera, bench: PulsedPylon) -> None:
    other = driver(bench)
    with pytest.raises(StateError, match="another program has the camera open; close it there"):
        other.open()
    assert other.state is State.CLOSED
    assert camera.snap()
    camera.close()
    with other:
        assert other.info()


def test_a_camera_that_cannot_be_opened_says_why(bench: PulsedPylon, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(camera: PulsedCamera) -> None:
        raise genicam.RuntimeException("No bandwidth left : RuntimeException thrown (file 'x.cpp', line 1)")

    camera = driver(bench)
    with monkeypatch.context() as patch:
        patch.setattr(PulsedCamera, "Open", refuse)
        with pytest.raises(DeviceError, match=r"^camera: open: pylon says: No bandwidth left; close"):
            camera.open()
    assert camera.state is State.CLOSED
    with camera:
        assert camera.info()


# Settings


def test_what_is_configured_stands_in_the_camera(camera: BaslerCamera) -> None:
    back = camera.configure(CameraSettings(0.0123, 6.0, 12))
    nodes = end(camera).instant
    assert nodes.PixelFormat.GetValue() == "Mono12"
    assert nodes.ExposureTime.GetValue() == back.exposure_s * 1e6 == 12300.0
    assert nodes.Gain.GetValue() == back.gain_db == pytest.approx(6.0, abs=1e-4)


def test_without_an_roi_it_is_the_whole_sensor() -> None:
    bench = PulsedPylon((1280, 1060))
    bench.start()
    try:
        with BaslerCamera("camera", {"serial": SERIAL}, SimpleNamespace(pylon=bench)) as camera:
            assert (camera.caps.size, camera.caps.offset) == ((1280, 1060), (0, 0))
            camera.configure(SETTINGS)
            assert camera.snap().image.shape == (1060, 1280)
    finally:
        bench.close()


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_an_roi_is_that_part_of_the_sensor_bit_by_bit(bits: int) -> None:
    whole = np.random.default_rng(bits).integers(0, 1 << bits, (1040, 1024), raw_dtype(bits))
    bench = PulsedPylon(scene=lambda settings: whole)
    bench.start()
    try:
        with driver(bench, roi=[37, 21, 50, 30]) as camera:
            assert (camera.caps.size, camera.caps.offset) == ((50, 30), (37, 21))
            camera.configure(replace(SETTINGS, bits=bits))
            np.testing.assert_array_equal(camera.snap().image, whole[21:51, 37:87])
    finally:
        bench.close()


@pytest.mark.parametrize(
    ("roi", "complaint"),
    [
        ([0, 0, 1025, 32], "Width is 1025; the camera takes 1 to 1024"),
        ([0, 0, 48, 5000], "Height is 5000; the camera takes 1 to 1040"),
        ([1000, 0, 48, 32], "OffsetX is 1000; the camera takes 0 to 976"),
        ([0, 1009, 48, 32], "OffsetY is 1009; the camera takes 0 to 1008"),
    ],
)
def test_an_roi_off_the_sensor_is_refused(bench: PulsedPylon, roi: list[int], complaint: str) -> None:
    camera = driver(bench, roi=roi)
    with pytest.raises(SettingError, match=complaint):
        camera.open()
    assert camera.state is State.CLOSED
    with driver(bench):
        pass


# Frames


def test_no_first_trigger_is_lost(camera: BaslerCamera, scene: Counter) -> None:
    for _ in range(40):
        assert shade(camera.snap(1.0)) == scene.exposures % 256


def test_no_first_pulse_is_lost(scene: Counter) -> None:
    """On a wire that does not wait: armed means ready."""
    bench = PulsedPylon(scene=scene, pulse_waits=False)
    bench.start()
    try:
        with driver(bench) as camera:
            camera.configure(SETTINGS)
            for _ in range(40):
                camera.arm(1, "hardware")
                bench.pulse()
                assert shade(camera.read(1.0)) == scene.exposures % 256
    finally:
        bench.close()


def test_every_pulse_is_a_frame_and_in_order(
    camera: BaslerCamera, bench: PulsedPylon, scene: Counter
) -> None:
    before = scene.exposures
    camera.arm(30, "hardware")
    wire = threading.Thread(target=bench.pulse, args=(30,))
    wire.start()
    taken = [camera.read(5.0) for _ in range(30)]
    wire.join()
    assert [shade(frame) - before for frame in taken] == list(range(1, 31))
    assert [frame.index for frame in taken] == list(range(30))


def test_frames_left_over_are_not_taken_for_new_ones(
    camera: BaslerCamera, bench: PulsedPylon, scene: Counter
) -> None:
    camera.arm(9, "hardware")
    bench.pulse(6)
    camera.read(1.0)
    camera.stop()
    before = scene.exposures
    camera.arm(3, "hardware")
    bench.pulse(3)
    taken = [camera.read(1.0) for _ in range(3)]
    assert [shade(frame) - before for frame in taken] == [1, 2, 3]


def test_pulses_reach_only_a_camera_that_waits_for_them(camera: BaslerCamera, bench: PulsedPylon) -> None:
    bench.pulse()
    camera.arm(1)
    bench.pulse()
    with pytest.raises(DeviceTimeoutError, match=r"no frame came within 0.05 s"):
        camera._retrieve(0.0, SOON_S)
    camera.stop()


@pytest.mark.whole
@pytest.mark.parametrize("kept", [3, 30])
def test_frames_stay_what_they_were(
    camera: BaslerCamera, scene: Counter, kept: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While more are taken, after the camera is stopped, closed, and gone; few buffers or many."""
    monkeypatch.setattr(buffers, "MAX_POOL_BYTES", 1)
    before = scene.exposures
    camera.arm(30)
    taken = [camera.read(5.0) for _ in range(30)][:kept]
    camera.arm(30)
    for _ in range(30):
        camera.read(5.0)
    camera.close()
    gc.collect()
    assert [shade(frame) - before for frame in taken] == list(range(1, kept + 1))


def addresses(camera: BaslerCamera, bench: PulsedPylon, n: int, keep: bool) -> list[int]:
    """Where the pixels of frames lie, one after another."""
    camera.arm(n, "hardware")
    held: list[Frame] = []
    found = []
    for _ in range(n):
        bench.pulse()
        frame = camera.read(5.0)
        found.append(frame.image.__array_interface__["data"][0])
        held += [frame] if keep else []
    return found


def test_frames_leave_in_pylons_own_buffers(
    camera: BaslerCamera, bench: PulsedPylon, monkeypatch: pytest.MonkeyPatch
) -> None:
    places: list[int] = []
    really_retrieve = PulsedCamera.RetrieveResult

    def noted(camera: PulsedCamera, timeout_ms: int, handling: Any) -> Any:
        result = really_retrieve(camera, timeout_ms, handling)
        if result.IsValid():
            view = np.frombuffer(result.GetImageMemoryView(), np.uint8)
            places.append(view.__array_interface__["data"][0])
        return result

    monkeypatch.setattr(PulsedCamera, "RetrieveResult", noted)
    assert addresses(camera, bench, 20, keep=True) == places
    assert len(set(places)) == 20
    places.clear()
    assert addresses(camera, bench, 60, keep=False) == places


def test_where_buffers_are_few_some_always_go_round(
    camera: BaslerCamera, bench: PulsedPylon, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(buffers, "MAX_POOL_BYTES", 1)
    camera.configure(camera._configured("test"))
    kept = camera.caps.buffers
    assert kept == buffers.SPARE_BUFFERS
    assert len(set(addresses(camera, bench, kept, keep=True))) == kept
    assert end(camera).MaxNumBuffer.GetValue() == 2 * buffers.SPARE_BUFFERS
    with pytest.raises(CapabilityError, match=r"5 triggered frames are to wait .*, and it keeps 4"):
        camera.arm(kept + 1, "hardware")


def test_triggers_of_the_hosts_own_need_few_buffers(camera: BaslerCamera) -> None:
    camera.arm(1000)
    assert end(camera).MaxNumBuffer.GetValue() == 2 * buffers.SPARE_BUFFERS
    camera.stop()
    camera.arm(1000, "hardware")
    assert end(camera).MaxNumBuffer.GetValue() == 1000 + buffers.SPARE_BUFFERS


# Settings in files


def test_all_settings_go_into_a_file_and_come_back(
    camera: BaslerCamera, bench: PulsedPylon, tmp_path: Path
) -> None:
    file = tmp_path / "camera.pfs"
    camera.configure(CameraSettings(0.0123, 6.0, 12))
    camera.save_features(file)
    camera.configure(CameraSettings(0.03, 0.0, 8))
    camera.load_features(file)
    nodes = end(camera).instant
    assert nodes.ExposureTime.GetValue() == 12300.0
    assert nodes.PixelFormat.GetValue() == "Mono12"
    with pytest.raises(StateError, match="is not configured"):
        camera.snap()
    camera.configure(SETTINGS)
    assert camera.snap()


def test_a_file_that_is_loaded_later_leaves_frames_raw_too(camera: BaslerCamera, tmp_path: Path) -> None:
    file = tmp_path / "camera.pfs"
    nodes = end(camera).instant
    nodes.ReverseX.SetValue(True)
    nodes.Gamma.SetValue(2.0)
    camera.save_features(file)
    camera.load_features(file)
    assert (nodes.Gamma.GetValue(), nodes.ReverseX.GetValue()) == (1.0, False)


def test_a_file_changes_what_the_camera_is(camera: BaslerCamera, tmp_path: Path) -> None:
    file = tmp_path / "camera.pfs"
    camera.save_features(file)
    file.write_text(file.read_text().replace("Width\t48\n", "Width\t40\n"))
    camera.load_features(file)
    assert camera.caps.size == (40, 32)


def test_a_file_is_loaded_first_and_frames_stay_raw(
    camera: BaslerCamera, bench: PulsedPylon, tmp_path: Path
) -> None:
    file = tmp_path / "camera.pfs"
    nodes = end(camera).instant
    nodes.BlackLevel.SetValue(7.0)
    nodes.ReverseX.SetValue(True)
    nodes.Gamma.SetValue(2.0)
    nodes.ExposureAuto.SetValue("Continuous")
    nodes.TriggerMode.SetValue("On")
    camera.save_features(file)
    camera.close()
    with driver(bench, features=str(file)) as other:
        nodes = end(other).instant
        assert nodes.BlackLevel.GetValue() == 7.0
        assert not nodes.ReverseX.GetValue()
        assert (nodes.Gamma.GetValue(), nodes.ExposureAuto.GetValue()) == (1.0, "Off")
        assert nodes.TriggerMode.GetValue() == "Off"
        assert other.caps.size == SIZE


def test_files_are_refused_while_frames_are_taken(camera: BaslerCamera, tmp_path: Path) -> None:
    file = tmp_path / "camera.pfs"
    camera.save_features(file)
    camera.arm(2)
    for use in (camera.load_features, camera.save_features):
        with pytest.raises(StateError, match="is armed; stop it first"):
            use(file)
    assert [camera.read(1.0).index for _ in range(2)] == [0, 1]


def test_a_file_that_is_not_there(camera: BaslerCamera, bench: PulsedPylon, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.pfs: there is no such file"):
        camera.load_features(tmp_path / "none.pfs")
    assert camera.snap()
    camera.close()
    with pytest.raises(ConfigError, match=r"none\.pfs: there is no such file"):
        driver(bench, features=str(tmp_path / "none.pfs")).open()


def test_a_file_that_does_not_fit(
    camera: BaslerCamera, bench: PulsedPylon, scene: Counter, tmp_path: Path
) -> None:
    file = tmp_path / "camera.pfs"
    camera.save_features(file)
    file.write_text(file.read_text().replace("Width\t48\n", "Width\t99999\n"))
    with pytest.raises(ConfigError, match=r"camera\.pfs: does not fit the camera 'camera': .*Width"):
        camera.load_features(file)
    assert camera.state is State.FAULT, "half of it may be loaded"
    assert_mended(camera, bench, scene)


def test_other_selectors_do_not_hold_frames_back(camera: BaslerCamera) -> None:
    camera.arm(1)
    nodes = end(camera).instant
    modes = {}
    for selector in nodes.TriggerSelector.GetSettableValues():
        nodes.TriggerSelector.SetValue(selector)
        modes[selector] = nodes.TriggerMode.GetValue()
    assert {name for name, mode in modes.items() if mode == "On"} == {"FrameStart"}


def test_pylon_is_the_default() -> None:
    assert isinstance(BaslerCamera("camera", {"serial": "1"})._transport.cameras(), dict)
    assert pylon.TlFactory.GetInstance() is not None


# A Bayer filter


@pytest.mark.parametrize("bits", [8, 12])
def test_frames_of_a_bayer_filter_are_the_sensors_own(bits: int) -> None:
    """The emulated colour camera offers Mono8 and RGB8 too, which are made of several pixels."""
    mosaic = np.arange(SIZE[0] * SIZE[1]).reshape(SIZE[::-1]) % (1 << bits)
    bench = PulsedPylon(scene=lambda settings: mosaic.astype(raw_dtype(settings.bits)), bayer="GBRG")
    bench.start()
    with driver(bench) as camera:
        assert camera.caps.bayer == "GBRG"
        camera.configure(replace(SETTINGS, bits=bits))
        assert end(camera).GetNodeMap().GetNode("PixelFormat").GetValue() == f"BayerGB{bits}"
        np.testing.assert_array_equal(camera.snap().image, mosaic)
    bench.close()


def test_a_camera_without_a_filter_has_no_colours(camera: BaslerCamera) -> None:
    assert camera.caps.bayer is None
    assert camera.caps.bits == (8, 12, 16)
