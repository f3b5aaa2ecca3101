"""The Basler driver on pylon's own camera emulator: every fault that it can make, and time-outs."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from pypylon import genicam

from drivers.basler import BaslerCamera
from fpplab.core.errors import (
    DeviceError,
    DeviceTimeoutError,
    DisconnectedError,
    FrameLossError,
)
from fpplab.devices import State
from tests.drivers.basler_bench import (
    LONG_S,
    SETTINGS,
    SOON_S,
    Counter,
    assert_disarmed,
    assert_mended,
    driver,
    end,
    unplug_once,
)
from tests.support.pulsed_pylon import PulsedPylon

# Time-outs


def test_a_frame_that_comes_too_late_is_taken_by_nobody(
    camera: BaslerCamera, bench: PulsedPylon, scene: Counter
) -> None:
    end(camera).set_exposure_duration(0.3)
    camera.arm(2)
    with pytest.raises(DeviceTimeoutError, match=r"no frame came within 0.05 s; allow more time"):
        camera.read(SOON_S)
    assert_disarmed(camera)
    late = scene.exposures
    assert_mended(camera, bench, scene)
    assert scene.exposures > late


def test_without_a_pulse_the_cable_is_suspected(camera: BaslerCamera) -> None:
    camera.arm(1, "hardware")
    with pytest.raises(DeviceTimeoutError, match="check the trigger cable"):
        camera.read(SOON_S)
    assert_disarmed(camera)


def test_a_camera_that_does_not_become_ready(camera: BaslerCamera) -> None:
    camera.arm(2)
    end(camera).set_exposure_duration(1.0)
    end(camera).instant.TriggerSoftware.Execute()
    with pytest.raises(DeviceTimeoutError, match="does not become ready for a trigger"):
        camera.read(SOON_S)
    assert_disarmed(camera)


# Faults


def test_a_frame_lost_on_the_way(camera: BaslerCamera, bench: PulsedPylon, scene: Counter) -> None:
    camera.arm(4, "hardware")
    bench.pulse(3)
    assert camera.read(1.0).index == 0
    end(camera).frames_to_lose = 1
    with pytest.raises(FrameLossError, match="frame 2 arrived instead of frame 1"):
        camera.read(1.0)
    assert_disarmed(camera)
    assert_mended(camera, bench, scene)


def test_the_first_frame_lost_on_the_way(camera: BaslerCamera, bench: PulsedPylon) -> None:
    camera.arm(4, "hardware")
    end(camera).frames_to_lose = 1
    bench.pulse(2)
    with pytest.raises(FrameLossError, match="frame 1 arrived instead of frame 0"):
        camera.read(1.0)
    assert_disarmed(camera)


def test_the_last_frame_lost_on_the_way(camera: BaslerCamera, bench: PulsedPylon) -> None:
    camera.arm(2, "hardware")
    bench.pulse(2)
    camera.read(1.0)
    end(camera).frames_to_lose = 1
    with pytest.raises(DeviceTimeoutError):
        camera.read(SOON_S)
    assert_disarmed(camera)


def test_an_incomplete_frame(camera: BaslerCamera, bench: PulsedPylon, scene: Counter) -> None:
    camera.arm(3)
    camera.read(1.0)
    end(camera).fail_frames(1)
    with pytest.raises(FrameLossError, match="frame 1 is damaged: The buffer was incompletely grabbed"):
        camera.read(1.0)
    assert_disarmed(camera)
    assert_mended(camera, bench, scene)


def test_a_frame_that_is_no_picture(
    camera: BaslerCamera, bench: PulsedPylon, scene: Counter, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(bench, "expose", lambda camera: bench.show_no_picture())
        with pytest.raises(FrameLossError, match=r"frame 0 is damaged: .*\(0x7\)"):
            camera.snap(1.0)
    assert_disarmed(camera)
    assert_mended(camera, bench, scene)


def test_a_picture_of_another_size(camera: BaslerCamera, bench: PulsedPylon, scene: Counter) -> None:
    bench.scene = lambda settings: np.zeros((16, 24), np.uint8)
    with pytest.raises(FrameLossError, match="frame 0 is"):
        camera.snap(1.0)
    assert_disarmed(camera)
    bench.scene = scene
    assert_mended(camera, bench, scene)


def test_pylons_engine_breaks_down(camera: BaslerCamera, bench: PulsedPylon, scene: Counter) -> None:
    camera.arm(3)
    camera.read(1.0)
    end(camera).fail_grabbing("out of transfer memory")
    with pytest.raises(DeviceError, match="pylon says: out of transfer memory; close it and open it again"):
        camera.read(1.0)
    assert_disarmed(camera)
    assert_mended(camera, bench, scene)


def test_pylon_stops_grabbing_by_itself(camera: BaslerCamera) -> None:
    camera.arm(3, "hardware")
    end(camera).instant.StopGrabbing()
    with pytest.raises(DeviceError, match="pylon stopped grabbing"):
        camera.read(LONG_S)
    assert_disarmed(camera)


USES: dict[str, Callable[[BaslerCamera], object]] = {
    "configure": lambda camera: camera.configure(SETTINGS),
    "arm": lambda camera: camera.arm(1),
    "arm for pulses": lambda camera: camera.arm(1, "hardware"),
    "snap": lambda camera: camera.snap(1.0),
    "save_features": lambda camera: camera.save_features(Path("never.pfs")),
}


@pytest.mark.whole
@pytest.mark.parametrize("use", USES.values(), ids=USES)
def test_unplugged_between_two_uses(
    camera: BaslerCamera, bench: PulsedPylon, scene: Counter, use: Callable[[BaslerCamera], object]
) -> None:
    camera.snap()
    bench.unplug()
    with pytest.raises(DisconnectedError, match="the camera was unplugged or switched off; plug it in"):
        use(camera)
    assert camera.state is State.FAULT
    assert_mended(camera, bench, scene)


@pytest.mark.whole
@pytest.mark.parametrize("trigger", ["software", "hardware"])
def test_unplugged_between_two_frames(
    camera: BaslerCamera, bench: PulsedPylon, scene: Counter, trigger: Any
) -> None:
    camera.arm(5, trigger)
    if trigger == "hardware":
        bench.pulse()
    camera.read(1.0)
    bench.unplug()
    with pytest.raises(DisconnectedError):
        camera.read(LONG_S)
    assert_disarmed(camera)
    assert_mended(camera, bench, scene)


def test_unplugged_while_a_frame_is_waited_for(camera: BaslerCamera, bench: PulsedPylon) -> None:
    """pylon lets the wait run into its time-out: the driver must not."""
    camera.arm(1, "hardware")
    hand = threading.Timer(SOON_S, bench.unplug)
    hand.start()
    with pytest.raises(DisconnectedError):
        camera.read(LONG_S)
    hand.join()
    assert_disarmed(camera)


def test_unplugged_and_pylon_gives_no_notice(
    camera: BaslerCamera, bench: PulsedPylon, scene: Counter
) -> None:
    camera.arm(1, "hardware")
    bench.unplug(noticed=False)
    with pytest.raises(DisconnectedError):
        camera.read(SOON_S)
    assert_disarmed(camera)
    assert_mended(camera, bench, scene)


def test_unplugged_it_can_be_closed_and_does_not_open(camera: BaslerCamera, bench: PulsedPylon) -> None:
    camera.arm(5)
    bench.unplug()
    camera.close()
    with pytest.raises(DisconnectedError, match="there is none"):
        camera.open()
    assert camera.state is State.CLOSED


@pytest.mark.whole
def test_unplugged_again_and_again_it_leaves_nothing(bench: PulsedPylon) -> None:
    camera, held = driver(bench), []
    for _ in range(3):
        unplug_once(camera, bench)
        process = psutil.Process()
        held.append((process.num_fds(), process.num_threads()))
    assert held[0] == held[1] == held[2]


def test_unplugged_after_it_was_listed(bench: PulsedPylon) -> None:
    (found,) = bench.cameras().values()
    bench.unplug()
    with pytest.raises(genicam.GenericException):
        bench.attach(found)
