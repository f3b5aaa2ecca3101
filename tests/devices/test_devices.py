"""What the base classes see to, whatever a backend does."""

import logging
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fpplab.core.errors import ConfigError, DataError, DeviceError, FrameLossError, SettingError, StateError
from fpplab.devices import CameraSettings, Device, Frame, State
from fpplab.patterns.fringes import Pattern, uniform_patterns
from tests.conformance.reference import (
    PROJECTOR_SIZE,
    ReferenceBench,
    ReferenceCamera,
    ReferenceProjector,
    ReferenceStage,
)


@pytest.fixture
def bench() -> ReferenceBench:
    bench = ReferenceBench({})
    bench.open()
    return bench


@pytest.fixture
def camera(bench: ReferenceBench) -> Iterator[ReferenceCamera]:
    with ReferenceCamera("camera", {}, bench) as camera:
        camera.configure(CameraSettings(0.02))
        yield camera


@pytest.fixture
def projector(bench: ReferenceBench) -> Iterator[ReferenceProjector]:
    with ReferenceProjector("projector", {}, bench) as projector:
        yield projector


def test_options_that_a_backend_does_not_know_are_refused(bench: ReferenceBench) -> None:
    for backend in (ReferenceCamera, ReferenceProjector, ReferenceStage):
        with pytest.raises(ConfigError, match="'gadget' has no option 'colour'; take it away"):
            backend("gadget", {"colour": "red"}, bench)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (
            {"image": np.zeros((32, 47), np.uint8)},
            r"frame 0 is an array \(32, 47\) of uint8; \(32, 48\) of uint8 was configured, rows",
        ),
        ({"image": np.zeros((48, 32), np.uint8)}, r"an array \(48, 32\) of uint8"),
        ({"image": np.zeros((32, 48), np.uint16)}, "of uint16"),
        ({"image": np.zeros((32, 48, 3), np.uint8)}, r"an array \(32, 48, 3\) of uint8"),
        ({"index": 1}, "frame 1 arrived instead of frame 0"),
        ({"index": -1}, "frame -1 arrived instead of frame 0"),
    ],
)
def test_a_damaged_frame_is_a_lost_one(
    camera: ReferenceCamera, monkeypatch: pytest.MonkeyPatch, change: dict[str, Any], complaint: str
) -> None:
    good = camera.snap()

    def damaged(timeout_s: float) -> Frame:
        return replace(good, **change)

    monkeypatch.setattr(camera, "_read", damaged)
    with pytest.raises(FrameLossError, match=complaint):
        camera.snap()
    assert camera.state is State.FAULT


def test_a_gap_in_a_run_is_a_lost_frame(camera: ReferenceCamera) -> None:
    camera.arm(3)
    camera.read(1.0)
    camera._count += 1
    with pytest.raises(FrameLossError, match="frame 2 arrived instead of frame 1"):
        camera.read(1.0)


def test_our_own_errors_pass_the_guard_with_their_exit_code(
    camera: ReferenceCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    def damaged() -> None:
        raise DataError("recording: is damaged")

    monkeypatch.setattr(camera, "_info", damaged)
    with pytest.raises(DataError, match=r"^recording: is damaged$"):
        camera.info()
    assert camera.state is State.FAULT


def test_an_interruption_is_no_fault(camera: ReferenceCamera, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(timeout_s: float) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(camera, "_read", interrupted)
        with pytest.raises(KeyboardInterrupt):
            camera.snap()
    assert camera.state is State.ARMED
    camera.stop()
    assert camera.snap().index == 0


def test_a_camera_that_cannot_stop_is_in_fault(
    camera: ReferenceCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken() -> None:
        raise OSError("it does not listen")

    monkeypatch.setattr(camera, "_stop", broken)
    with pytest.raises(DeviceError, match="stop: OSError: it does not listen"):
        camera.snap()
    assert camera.state is State.FAULT


def test_a_backend_that_refuses_leaves_the_settings(
    camera: ReferenceCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(settings: CameraSettings) -> CameraSettings:
        raise StateError("camera", "configure", "is warming up")

    good = camera.snap().settings
    with monkeypatch.context() as patch:
        patch.setattr(camera, "_configure", refuse)
        with pytest.raises(StateError, match="warming up"):
            camera.configure(CameraSettings(0.5))
    assert camera.state is State.IDLE
    assert camera.snap().settings == good


@pytest.mark.parametrize(
    "done", [CameraSettings(0.4), CameraSettings(0.5, gain_db=1.0), CameraSettings(0.5, bits=12)]
)
def test_a_backend_that_clamps_is_found_out(
    camera: ReferenceCamera, monkeypatch: pytest.MonkeyPatch, done: CameraSettings
) -> None:
    monkeypatch.setattr(camera, "_configure", lambda settings: done)
    with pytest.raises(SettingError, match="was asked for, but the device reads"):
        camera.configure(CameraSettings(0.5))
    with pytest.raises(StateError, match="is not configured"):
        camera.snap()


def test_a_failed_opening_is_cleaned_up(bench: ReferenceBench, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    stage = ReferenceStage("stage", {}, bench)

    def half() -> None:
        calls.append("open")
        raise OSError("no answer")

    monkeypatch.setattr(stage, "_open", half)
    monkeypatch.setattr(stage, "_close", lambda: calls.append("close"))
    with pytest.raises(DeviceError, match="stage: open: OSError: no answer"):
        stage.open()
    assert calls == ["open", "close"]


def test_a_failed_homing_loses_the_reference(bench: ReferenceBench, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    with ReferenceStage("stage", {}, bench) as stage:
        stage.home()
        with monkeypatch.context() as patch:
            patch.setattr(stage, "_home", interrupted)
            with pytest.raises(KeyboardInterrupt):
                stage.home()
        with pytest.raises(StateError, match="not homed"):
            stage.move_to(1.0)


def test_the_slowest_pattern_sets_the_pace(projector: ReferenceProjector) -> None:
    white, black = uniform_patterns([255, 0], PROJECTOR_SIZE)
    fast = [replace(white, bit_depth=1), replace(black, bit_depth=1)]
    projector.load(fast)
    projector.play(1e-3)
    projector.blank()
    projector.load([*fast, white])
    with pytest.raises(DeviceError, match=r"exposure_s is 0.001 s; at least 0.008 s"):
        projector.play(1e-3)


def test_a_refused_load_reaches_no_hook(
    projector: ReferenceProjector, monkeypatch: pytest.MonkeyPatch
) -> None:
    def called(patterns: object) -> None:
        pytest.fail("the device was given a load that is refused")

    monkeypatch.setattr(projector, "_load", called)
    good = uniform_patterns([255], PROJECTOR_SIZE)
    with pytest.raises(DeviceError, match=r"pattern bad is float64, 24 x 16; .* uint8, 24 x 16 mirrors"):
        projector.load([*good, Pattern("bad", np.zeros((16, 24)))])  # type: ignore[arg-type]


def test_a_driver_is_given_a_copy_of_each_pattern(
    projector: ReferenceProjector, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(projector, "_load", lambda patterns: patterns)
    (white,) = uniform_patterns([255], PROJECTOR_SIZE)
    (loaded,) = projector.load([white])
    white.image[:] = 0
    assert (loaded.image == 255).all()


def test_names_of_devices_are_in_their_errors(bench: ReferenceBench) -> None:
    device: Device = ReferenceCamera("left eye", {}, bench)
    with pytest.raises(DeviceError, match="left eye: info: is not open; open it first") as caught:
        device.info()
    assert caught.value.exit_code == 3


@pytest.mark.parametrize(
    ("hook", "asked", "said"),
    [
        ("_configure", lambda camera: camera.configure(CameraSettings(0.01)), "NoneType, not CameraSettings"),
        ("_caps", lambda camera: camera.caps, "NoneType, not CameraCaps"),
        ("_info", lambda camera: camera.info(), "NoneType, not DeviceInfo"),
    ],
)
def test_a_hook_that_gives_another_kind_is_named(
    hook: str,
    asked: Callable[[ReferenceCamera], object],
    said: str,
    camera: ReferenceCamera,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ReferenceCamera, hook, lambda *_: None)
    with pytest.raises(DeviceError, match=f"ReferenceCamera.{hook} gives {said}; fix the driver"):
        asked(camera)
    assert camera.state is State.FAULT


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"bits": 12}, "CameraCaps.bits is 12; it must be a tuple"),
        ({"exposure_s": (20.0, 2e6)}, "begins at 20 s; it is in seconds, not in µs"),
        ({"triggers": ("software", "line1")}, "triggers has 'line1'; there are software, hardware"),
    ],
)
def test_capabilities_that_cannot_be_are_named(
    changed: dict[str, Any], said: str, camera: ReferenceCamera, monkeypatch: pytest.MonkeyPatch
) -> None:
    caps = camera.caps
    monkeypatch.setattr(camera, "_caps", lambda: replace(caps, **changed))
    with pytest.raises(DeviceError, match=said):
        _ = camera.caps


def test_an_error_in_a_driver_names_its_line_and_is_logged(
    bench: ReferenceBench,
    caplog: pytest.LogCaptureFixture,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    source = tmp_path / "worn_driver.py"
    source.write_text(
        "from tests.conformance.reference import ReferenceStage\n"
        "class Worn(ReferenceStage):\n"
        "    def _home(self):\n"
        "        raise KeyError('axis')\n"
    )
    spec = spec_from_file_location("worn_driver", source)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "worn_driver", module)
    spec.loader.exec_module(module)
    stage = module.Worn("stage", {}, bench)
    stage.open()
    with (
        caplog.at_level(logging.DEBUG),
        pytest.raises(DeviceError, match=r"worn_driver.py, line 4.*--log FILE"),
    ):
        stage.home()
    assert "KeyError" in (caplog.records[-1].exc_text or caplog.text)
