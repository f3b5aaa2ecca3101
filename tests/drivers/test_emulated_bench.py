"""The emulated bench: what the real drivers take is what the optics capture of the projected patterns."""

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.emulators.bench import BenchFaults, EmulatedFixture
from drivers.emulators.dlpc350 import UsbFault
from drivers.emulators.exposure import ALWAYS_READY
from drivers.genicam import buffers
from fpplab.core.conventions import Image
from fpplab.core.errors import (
    CapabilityError,
    ConfigError,
    DeviceTimeoutError,
    DisconnectedError,
    SettingError,
)
from fpplab.devices import CameraSettings, Frame, State
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import Pattern
from tests.conformance.reference import CAMERA_SIZE
from tests.drivers.basler_bench import end
from tests.drivers.emulated_rig import (
    PLAN,
    bench_of,
    burn,
    on_video,
    patterns,
    reference,
    rig_file,
    seen,
    taken,
)

TRIGGERED = PLAN.model_copy(update={"trigger": "triggered"})
SOON_S = 0.05
AT_ONCE = {"sensor": ALWAYS_READY.model_dump()}
"""A camera that takes a pulse as soon as an exposure has ended, for what patterns in sequence look like."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("emulated")
    burn(folder)
    return folder


def mixed(*shares: tuple[int, float]) -> np.ndarray[Any, Any]:
    """Grey levels of patterns that share an exposure."""
    light = sum(share * patterns()[i].image.astype(float) for i, share in shares)
    return np.asarray(np.rint(light), np.uint8)


def expected(*images: np.ndarray[Any, Any] | None, **settings: Any) -> list[Image]:
    """Capture images of patterns one after another with the optics alone."""
    with reference() as rig:
        return [seen(rig, image, **settings) for image in images]


def assert_within_rounding(frame: Image, image: Image) -> None:
    """Compare images of grey levels that share an exposure: to half a grey level, here 16 of 4095 at most."""
    np.testing.assert_allclose(frame.astype(int), image.astype(int), rtol=0, atol=18)


def played(rig: Rig, count: int, exposure_s: float = PLAN.exposure_s, play_s: float = 0.02) -> list[Image]:
    """Capture frames of so many pulses, of patterns that are played for `play_s` each."""
    rig.camera.configure(rig.camera_settings(exposure_s))
    rig.projector.load(patterns())
    rig.camera.arm(count, "hardware")
    rig.projector.play(play_s)
    return [rig.camera.read(SOON_S).image for _ in range(count)]


@pytest.mark.whole
@pytest.mark.parametrize(("trigger", "bits"), [("stepped", 8), ("triggered", 12)])
@pytest.mark.parametrize("rig_on", [rig_file, on_video])
def test_frames_are_those_of_the_optics_to_the_last_bit(
    folder: Path, trigger: str, bits: int, rig_on: Callable[..., Rig]
) -> None:
    """The noise is equal too, because the optics take one frame for each."""
    plan = PLAN.model_copy(update={"trigger": trigger, "exposure_s": 0.016})
    wanted = expected(*(pattern.image for pattern in patterns()), bits=bits, exposure_s=plan.exposure_s)
    with rig_on(folder, camera={"bits": bits}) as rig:
        for frame, image in zip(taken(rig, plan), wanted, strict=True):
            np.testing.assert_array_equal(frame, image)


@pytest.mark.whole
@pytest.mark.parametrize(
    "sizes", [2, pytest.param(100, marks=[pytest.mark.nightly, pytest.mark.timeout(1800)])]
)
def test_plans_that_do_not_fit_into_the_buffers_are_taken_in_parts(
    folder: Path, monkeypatch: pytest.MonkeyPatch, sizes: int
) -> None:
    """Over the video port no frame is read before all of a part are exposed."""
    plan = TRIGGERED.model_copy(update={"exposure_s": 0.008333})
    random = np.random.default_rng(41)
    monkeypatch.setattr(buffers, "SPARE_BUFFERS", 1)
    with on_video(folder) as rig:
        whole = list(taken(rig, plan))
        frame_bytes = 2 * CAMERA_SIZE[0] * CAMERA_SIZE[1]
        for held in random.integers(1, 10, sizes):
            monkeypatch.setattr(buffers, "MAX_POOL_BYTES", (held + 1) * frame_bytes)
            for frame, image in zip(taken(rig, plan), whole, strict=True):
                np.testing.assert_allclose(frame.astype(int), image.astype(int), rtol=0, atol=40)
            assert rig.camera.caps.buffers == held
        monkeypatch.setattr(buffers, "MAX_POOL_BYTES", 4 * frame_bytes)
        unprovable = plan.model_copy(update={"fringes": plan.fringes[:1]})
        with pytest.raises(CapabilityError, match=r"4 triggered frames are to wait .*, and it keeps 3"):
            next(taken(rig, unprovable, patterns()[:4]))


@pytest.mark.whole
def test_patterns_follow_the_camera(folder: Path) -> None:
    """Each edge of its output brings the next pattern, whole, for 3 x 8.333 ms of 25.5 ms."""
    plan = PLAN.model_copy(update={"trigger": "followed", "exposure_s": 0.0255})
    with rig_file(folder, camera={"strobe": "Line2"}) as rig:
        stepped = list(taken(rig, plan.model_copy(update={"trigger": "stepped"})))
        for frame, image in zip(taken(rig, plan), stepped, strict=True):
            unsaturated = image < 3900
            expected_light = image[unsaturated] * (24.999 / 25.5)
            np.testing.assert_allclose(frame[unsaturated], expected_light, rtol=0.02, atol=60)
        with pytest.raises(SettingError, match=r"exposures of 8\.\d+ ms .*at least 20 ms"):
            next(taken(rig, plan.model_copy(update={"exposure_s": 0.0084})))


@pytest.mark.parametrize(
    ("rig_on", "strobe", "complaint"),
    [(rig_file, None, "active while it exposes"), (on_video, "Line2", "has no trigger input")],
)
def test_what_cannot_follow_is_refused(
    folder: Path, rig_on: Callable[..., Rig], strobe: str | None, complaint: str
) -> None:
    plan = PLAN.model_copy(update={"trigger": "followed"})
    with rig_on(folder, camera={"strobe": strobe}) as rig, pytest.raises(CapabilityError, match=complaint):
        next(taken(rig, plan))


@pytest.mark.whole
def test_without_a_cable_no_pattern_follows(folder: Path) -> None:
    plan = PLAN.model_copy(update={"trigger": "followed", "exposure_s": 0.0255})
    with rig_file(folder, {"faults": {"cut": True}}, {"strobe": "Line2"}) as rig:
        frames = list(taken(rig, plan))
    assert max(frame.max() for frame in frames) < 200  # darkness alone


def test_a_depth_that_the_optics_lack_is_shifted_up(folder: Path) -> None:
    (wanted,) = expected(patterns()[0].image)
    with rig_file(folder, camera={"bits": 16}) as rig:
        np.testing.assert_array_equal(next(taken(rig)), wanted << 4)


def test_led_levels_dim_the_light(folder: Path) -> None:
    levels = {"red": 102, "green": 0, "blue": 51}
    (wanted,) = expected(mixed((0, 0.2)))
    with rig_file(folder, projector={"led_levels": levels}) as rig:
        np.testing.assert_array_equal(next(taken(rig)), wanted)


def test_beyond_the_picture_the_sensor_is_dark(folder: Path) -> None:
    with rig_file(folder, camera={"roi": None}) as rig:
        frame = next(taken(rig))
    width, height = CAMERA_SIZE
    assert frame.shape == (1040, 1024)
    assert frame[:height, :width].any()
    assert not frame[height:].any()
    assert not frame[:, width:].any()


def test_a_part_of_the_picture(folder: Path) -> None:
    (wanted,) = expected(patterns()[0].image)
    with rig_file(folder, camera={"roi": [8, 4, 16, 12]}) as rig:
        np.testing.assert_array_equal(next(taken(rig)), wanted[4:16, 8:24])


# The trigger cable


def test_a_pattern_that_ends_in_an_exposure_is_mixed_with_the_next(folder: Path) -> None:
    wanted = expected(*(mixed((i, 0.75), (i + 1, 0.25)) for i in range(7)))
    with rig_file(folder, AT_ONCE, {"trigger": {"delay_us": 5000.0}}) as rig:
        for frame, image in zip(played(rig, 7), wanted, strict=True):
            assert_within_rounding(frame, image)


def test_dark_between_patterns_dims_them(folder: Path) -> None:
    """Three images: each has to be loaded while the one before it is shown, which takes 30 ms here."""
    wanted = expected(*(mixed((i, 0.5)) for i in range(8)))
    with rig_file(folder) as rig:
        bench_of(rig).controller.load_s = [0.06] * len(bench_of(rig).controller.images)
        frames = played(rig, 8, exposure_s=0.02, play_s=0.01)
        for frame, image in zip(frames, wanted, strict=True):
            assert_within_rounding(frame, image)


def test_an_inverted_output_shows_each_pattern_one_too_late(folder: Path) -> None:
    wanted = expected(*(patterns()[i].image for i in range(1, 8)))
    with rig_file(folder, AT_ONCE, projector={"trigger_out_1": {"inverted": True}}) as rig:
        for frame, image in zip(played(rig, 7), wanted, strict=True):
            np.testing.assert_array_equal(frame, image)
    with rig_file(folder, AT_ONCE, {"trigger": {"edge": "falling"}}) as rig:
        np.testing.assert_array_equal(played(rig, 1)[0], wanted[0])


def test_a_line_that_was_left_inverted_is_mended(folder: Path) -> None:
    """Another program has inverted the camera's input: left so, frames would show the next pattern."""
    (wanted,) = expected(patterns()[0].image)
    with rig_file(folder) as rig:
        camera = end(rig.camera)
        camera.instant.LineSelector.SetValue("Line1")
        camera.instant.LineInverter.SetValue(True)
        np.testing.assert_array_equal(next(iter(taken(rig, TRIGGERED))), wanted)


def test_pulses_at_an_open_shutter_are_lost(folder: Path) -> None:
    wanted = expected(*(mixed((i, 2 / 3), (i + 1, 1 / 3)) for i in (0, 2, 4)), exposure_s=0.03)
    with rig_file(folder, AT_ONCE) as rig:
        for frame, image in zip(played(rig, 3, exposure_s=0.03), wanted, strict=True):
            assert_within_rounding(frame, image)


def test_a_shutter_is_not_kept_open_by_rounding(folder: Path) -> None:
    with rig_file(folder, AT_ONCE) as rig:
        shutter = bench_of(rig).shutter
        for k in range(20):
            shutter.open(CameraSettings(0.1), 0.1 * k)
        assert len(list(iter(lambda: shutter.wait_next(0.0), None))) == 20


def test_a_missed_pulse_shifts_what_follows(folder: Path) -> None:
    order = (0, 1, 2, 4, 5, 6, 7)
    wanted = expected(*(patterns()[i].image for i in order))
    with rig_file(folder, {"faults": {"missed": [3]}}) as rig:
        shots = taken(rig, TRIGGERED)
        for image in wanted:
            np.testing.assert_array_equal(next(shots), image)


def test_after_a_missed_pulse_the_last_frame_never_comes(folder: Path) -> None:
    with rig_file(folder, AT_ONCE | {"faults": {"missed": [3]}}) as rig:
        assert len(played(rig, 7)) == 7
        rig.projector.blank()
        with pytest.raises(DeviceTimeoutError, match="check the trigger cable"):
            played(rig, 8)


def test_a_doubled_pulse_shifts_what_follows(folder: Path) -> None:
    order = (0, 1, 2, 2, 3, 4, 5, 6)
    wanted = expected(*(patterns()[i].image for i in order))
    with rig_file(folder, {"faults": {"doubled": [2]}}) as rig:
        for frame, image in zip(taken(rig, TRIGGERED), wanted, strict=True):
            np.testing.assert_array_equal(frame, image)


def test_a_pulse_too_many_shifts_all(folder: Path) -> None:
    wanted = expected(None, *(pattern.image for pattern in patterns()[:-1]))
    with rig_file(folder, {"faults": {"extra": True}}) as rig:
        for frame, image in zip(taken(rig, TRIGGERED), wanted, strict=True):
            np.testing.assert_array_equal(frame, image)


def test_each_run_begins_anew(folder: Path) -> None:
    with rig_file(folder, AT_ONCE) as rig:
        bench = bench_of(rig)
        for faults, count in (
            (BenchFaults(missed=(0,)), 7),
            (BenchFaults(), 8),
            (BenchFaults(doubled=(7,)), 8),
        ):
            bench.faults = faults
            assert len(played(rig, count)) == count
            rig.make_dark()


# When the camera is ready


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("rig_on", [rig_file, on_video])
@pytest.mark.parametrize(
    "dead_us",
    [0.0, 231.0, 300.0, *(pytest.param(us, marks=pytest.mark.nightly) for us in (30.0, 100.0))],
)
def test_no_pulse_comes_before_the_camera_is_ready(
    folder: Path, dead_us: float, rig_on: Callable[..., Rig]
) -> None:
    plan = TRIGGERED.model_copy(update={"exposure_s": 0.016})
    wanted = expected(*(pattern.image for pattern in patterns()), exposure_s=plan.exposure_s)
    with rig_on(folder, {"sensor": {"dead_us": dead_us}}) as rig:
        for frame, image in zip(taken(rig, plan), wanted, strict=True):
            np.testing.assert_array_equal(frame, image)
        assert bench_of(rig).shutter.ignored == 0


@pytest.mark.whole
@pytest.mark.parametrize("rig_on", [rig_file, on_video])
def test_a_readout_longer_than_the_exposure(folder: Path, rig_on: Callable[..., Rig]) -> None:
    with rig_on(folder, {"sensor": {"readout_us": 58e3}}) as rig:
        assert len(list(taken(rig, TRIGGERED.model_copy(update={"exposure_s": 0.016})))) == 8
        assert bench_of(rig).shutter.ignored == 0


def test_without_time_between_exposures_every_other_pulse_is_ignored(folder: Path) -> None:
    """Of eight patterns that follow each other at once, four frames come."""
    with rig_file(folder, {"sensor": {"dead_us": 30.0}}) as rig:
        with pytest.raises(DeviceTimeoutError):
            played(rig, 5)
        assert bench_of(rig).shutter.ignored == 4


# Time


def test_slow_optics_are_not_late(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with rig_file(folder) as rig:
        optics = bench_of(rig).optics_rig.camera
        really_read = optics._read

        def slowly(timeout_s: float) -> Frame:
            time.sleep(2 * SOON_S)
            return really_read(timeout_s)

        monkeypatch.setattr(optics, "_read", slowly)
        assert len(played(rig, 2)) == 2
        rig.make_dark()
        rig.camera.snap(SOON_S)


def test_what_is_due_in_a_sleep_happens_at_its_time(folder: Path) -> None:
    with rig_file(folder) as rig:
        bench = bench_of(rig)
        rises: list[tuple[float, float]] = []
        bench.controller.on_pulse = lambda pulse: (
            rises.append((pulse.rise_s, bench.clock.now())) if pulse.output == 1 else None
        )
        rig.projector.load(patterns())
        rig.projector.play(0.02)
        bench.clock.sleep(1.0)
    assert np.diff([rise for rise, _ in rises]) == pytest.approx([0.02] * 7)
    assert [now for _, now in rises] == pytest.approx([rise for rise, _ in rises], abs=1e-9)


# What the optics are given


def test_all_that_is_in_flash_is_loaded_at_once(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that a simulation can compute related patterns once, and keep the results."""
    with rig_file(folder) as rig:
        optics = bench_of(rig).optics_rig.projector
        really_load, loads = optics._load, []

        def noted(given: list[Pattern]) -> Any:
            loads.append(len(given))
            return really_load(given)

        monkeypatch.setattr(optics, "_load", noted)
        list(taken(rig))
        list(taken(rig, TRIGGERED))
    assert loads == [len({p.image.tobytes() for p in patterns()}) + 1], "and the black of the last image"


def test_what_the_optics_refuse_is_said(folder: Path) -> None:
    with rig_file(folder) as rig:
        rig.camera.configure(rig.camera_settings(2.0))
        with pytest.raises(SettingError, match=r"exposure_s is 2 s; the device accepts 0\.0001 to 1 s"):
            rig.camera.snap()


def test_the_stage_carries_the_optics_stage(folder: Path) -> None:
    with rig_file(folder) as rig:
        inner, stage = bench_of(rig).optics_rig.stage, rig.stage
        assert inner is not None
        assert stage is not None
        next(taken(rig))
        assert inner.state is State.IDLE
        stage.home()
        assert stage.caps.travel_mm == pytest.approx(inner.caps.travel_mm, abs=0.01)
        there = stage.move_to(12.5)
        next(taken(rig))
        assert inner.position_mm == pytest.approx(there, abs=0.0125 / 2)
        stage.move_to(0.0)
        next(taken(rig))
        assert inner.position_mm == 0.0


def test_the_fixture_is_that_of_the_optics(folder: Path) -> None:
    with rig_file(folder) as rig:
        fixture = rig.need_fixture("this test")
        assert fixture.caps.items == {"white": None, "grey": 2}
        white = next(taken(rig)).astype(float).mean()
        fixture.mount("grey", 1)
        assert next(taken(rig)).astype(float).mean() == pytest.approx(white / 2, rel=0.1)
        assert fixture.pose("grey", 1) is None


# Wires that fail


def test_a_reply_that_is_late_or_lost(folder: Path) -> None:
    with rig_file(folder, {"faults": {"late": [60]}}) as rig, pytest.raises(DeviceTimeoutError):
        list(taken(rig))
    with rig_file(folder) as rig:
        bench = bench_of(rig)
        bench.hid.faults[bench.hid.requests + 20] = UsbFault.DROP
        with pytest.raises(DeviceTimeoutError):
            list(taken(rig))
        assert bench.controller.light() is None


def test_a_projector_that_is_unplugged(folder: Path) -> None:
    rig = rig_file(folder, {"faults": {"unplug_projector": 60}})
    with pytest.raises(DisconnectedError), rig:
        list(taken(rig))


def test_a_camera_that_is_unplugged(folder: Path) -> None:
    with rig_file(folder, {"faults": {"unplug_camera": 3}}) as rig:
        shots = taken(rig, TRIGGERED)
        assert len([next(shots) for _ in range(2)]) == 2
        with pytest.raises(DisconnectedError):
            list(shots)
        assert bench_of(rig).controller.light() is None
        rig.camera.close()
        bench_of(rig).pylon.plug_in()
        rig.camera.open()
        assert next(taken(rig)).any()


# What is refused


@pytest.mark.parametrize(
    ("bench", "said"),
    [
        ({"firmware": "nowhere.bin"}, "cannot be read"),
        ({"firmware": "patterns.yaml"}, "the projector refused the command"),
        ({"faults": {"missed": [-1]}}, "missed"),
        ({"light": 3}, "unknown key 'light'"),
    ],
)
def test_wrong_options_are_refused(folder: Path, bench: dict[str, Any], said: str) -> None:
    with pytest.raises(Exception, match=said), rig_file(folder, bench):
        pass


def test_a_bench_is_not_its_own_optics(folder: Path) -> None:
    inner = rig_file(folder)
    (folder / "inner.yaml").write_text(
        "name: inner\nbench: {backend: 'drivers.emulators.bench:EmulatedBench', optics: rig_demo.yaml}\n"
        "camera: {backend: 'a:B'}\nprojector: {backend: 'a:B'}\n",
        encoding="utf-8",
    )
    with (
        pytest.raises(ConfigError, match="an emulated bench itself"),
        rig_file(folder, {"optics": str(folder / "inner.yaml")}),
    ):
        pass
    assert inner.stage is None


def test_the_fixture_needs_the_bench() -> None:
    with pytest.raises(ConfigError, match="needs the bench"):
        EmulatedFixture("fixture", {}, None)


def test_nothing_is_left_open(folder: Path) -> None:
    with rig_file(folder) as rig:
        inner = bench_of(rig).optics_rig
        next(taken(rig))
    assert inner.camera.state is inner.projector.state is State.CLOSED
