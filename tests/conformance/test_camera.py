"""What every camera does, and what it refuses."""

import math
import time
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from fpplab.acquisition.timing import pulse_timing
from fpplab.core.errors import CapabilityError, DeviceTimeoutError, FrameLossError, SettingError, StateError
from fpplab.devices import Camera, CameraSettings, Frame, State
from fpplab.devices.rig import Rig
from tests.conformance.bench import (
    BLACK,
    DISTINCT,
    GREY,
    WHITE,
    LosesFrames,
    brightness,
    check_unknown_key,
    contrast,
    dim_plan,
    patterns_for,
)

PROBE = 1.0 / math.pi
"""A point of a range that lies on nobody's grid."""
LONGER = 4.0
"""Factor by which exposures differ that must be seen in a picture."""
NEXT_FRAMES = 6
"""So many frames after a change of settings: more than a camera or its driver holds back."""
LEAST_CONTRAST = 10.0
"""Contrast of a scene, as a multiple of the noise, by which a change of brightness is judged."""
LEAST_WHITE = 0.05
"""Share of full scale that white has at least at 20 ms."""
NOISY_PX = 50
"""So many pixels that differ between two pictures of one scene are noise, and no two pictures are equal."""


def settings_of(rig: Rig) -> CameraSettings:
    return rig.camera_settings(dim_plan(rig).exposure_s)


def near(camera: Camera, exposure_s: float) -> Any:
    return pytest.approx(exposure_s, abs=max(0.02 * exposure_s, 0.51 * camera.caps.exposure_step_s))


def show(rig: Rig, i: int) -> None:
    """Give the camera something to see."""
    rig.projector.load(patterns_for(rig))
    rig.projector.show(i)


def test_caps_make_sense(camera: Camera) -> None:
    caps = camera.caps
    assert caps.size[0] > 0
    assert caps.size[1] > 0
    assert 0 < caps.exposure_s[0] <= caps.exposure_s[1]
    assert caps.gain_db[0] <= caps.gain_db[1]
    assert caps.bits
    assert set(caps.bits) <= set(range(8, 17))
    assert caps.triggers


def test_settings_are_read_back(rig: Rig, camera: Camera) -> None:
    show(rig, WHITE)
    least, most = camera.caps.exposure_s
    wanted = replace(settings_of(rig), exposure_s=least + (min(most, 0.05) - least) * PROBE)
    back = camera.configure(wanted)
    assert back.exposure_s == near(camera, wanted.exposure_s)
    assert back.gain_db == pytest.approx(wanted.gain_db, abs=0.5)
    assert back.bits == wanted.bits
    assert camera.snap().settings == back
    assert camera.configure(back) == back


@pytest.mark.parametrize("bound", [0, 1])
def test_both_ends_of_the_ranges_are_accepted(rig: Rig, camera: Camera, bound: int) -> None:
    caps = camera.caps
    wanted = replace(settings_of(rig), exposure_s=caps.exposure_s[bound], gain_db=caps.gain_db[bound])
    back = camera.configure(wanted)
    assert back.exposure_s == near(camera, wanted.exposure_s)
    assert back.gain_db == pytest.approx(wanted.gain_db, abs=0.5)


def test_what_lies_outside_is_refused_and_the_old_settings_stay(rig: Rig, camera: Camera) -> None:
    show(rig, WHITE)
    caps, good = camera.caps, camera.configure(settings_of(rig))
    outside = [
        replace(good, exposure_s=math.nextafter(caps.exposure_s[0], -math.inf)),
        replace(good, exposure_s=math.nextafter(caps.exposure_s[1], math.inf)),
        replace(good, exposure_s=math.nan),
        replace(good, exposure_s=-good.exposure_s),
        replace(good, gain_db=math.nextafter(caps.gain_db[0], -math.inf)),
        replace(good, gain_db=math.nextafter(caps.gain_db[1], math.inf)),
        replace(good, gain_db=math.nan),
        *(replace(good, bits=bits) for bits in range(1, 18) if bits not in caps.bits),
    ]
    for settings in outside:
        with pytest.raises(SettingError, match="configure"):
            camera.configure(settings)
        assert camera.state is State.IDLE
    assert camera.snap().settings == good


def test_it_must_be_configured_first_also_after_reopening(camera: Camera) -> None:
    camera.close()
    camera.open()
    for use in (camera.snap, lambda: camera.arm(1)):
        with pytest.raises(StateError, match="not configured"):
            use()
    assert camera.state is State.IDLE


def test_a_key_that_is_misspelt_is_refused(rig: Rig, camera: Camera) -> None:
    check_unknown_key(rig, camera)


def test_a_change_of_settings_shows_in_the_next_frame(rig: Rig, camera: Camera) -> None:
    """A picture with four times the exposure has four times the contrast: what is read back is there."""
    show(rig, DISTINCT[2])
    usual = settings_of(rig)
    long = suited_to_the_scene(camera, usual)
    short = replace(long, exposure_s=long.exposure_s / LONGER)
    seen = {}
    for settings in (long, short, long):
        back = camera.configure(settings)
        frames = next_frames(camera)
        now = np.mean([contrast(frame) for frame in frames[-2:]])
        late = [k for k, frame in enumerate(frames, 1) if not 0.7 < contrast(frame) / now < 1.4]
        assert not late, (
            f"frame {late[-1]} after `configure` still has the exposure from before: it was exposed earlier, "
            "and `_arm` must drop what waits; or settings act late, see `late` of `fpplab.devices.FreeRun`"
        )
        seen[back.exposure_s] = now
    factor, found = max(seen) / min(seen), seen[max(seen)] / seen[min(seen)]
    assert 0.6 < found / factor < 1.6, (
        f"the exposure is read back {factor:.2f} times as long, but the contrast is {found:.2f} times as "
        "high: `_configure` must give back what the device reads, in s, and grey levels must be raw"
    )


def suited_to_the_scene(camera: Camera, settings: CameraSettings) -> CameraSettings:
    """An exposure at which the scene is neither black nor white."""
    least, most = camera.caps.exposure_s
    while True:
        camera.configure(settings)
        frames = next_frames(camera)
        full = np.quantile(frames[-1].image, 0.98) / ((1 << settings.bits) - 1)
        longer, shorter = settings.exposure_s * LONGER, settings.exposure_s / LONGER
        if full > 0.8 and shorter / LONGER >= least:
            settings = replace(settings, exposure_s=shorter)
            continue
        noise = float(np.std(frames[-1].image.astype(float) - frames[-2].image)) / (1 << settings.bits)
        if full <= 0.8 and shorter >= least and contrast(frames[-1]) > LEAST_CONTRAST * noise:
            return settings
        if full > 0.2 or longer > min(most, 0.5):
            pytest.skip("the camera sees too little contrast, or is at the end of its exposures")
        settings = replace(settings, exposure_s=longer)


def next_frames(camera: Camera) -> list[Frame]:
    camera.arm(NEXT_FRAMES)
    return [camera.read(10.0) for _ in range(NEXT_FRAMES)]


def test_no_frame_comes_sooner_than_it_is_exposed(rig: Rig, camera: Camera) -> None:
    """A frame that comes at once was exposed before it was asked for; by then the light was another one."""
    show(rig, WHITE)
    least, most = camera.caps.exposure_s
    exposure_s = camera.configure(replace(settings_of(rig), exposure_s=min(max(0.1, least), most))).exposure_s
    camera.arm(NEXT_FRAMES)
    time.sleep(2.0 * exposure_s)
    took_s = []
    for _ in range(NEXT_FRAMES):
        before_s = time.monotonic()
        camera.read(10.0)
        took_s.append(time.monotonic() - before_s)
    if took_s[-1] < 0.5 * exposure_s:
        pytest.skip("frames take no time: the camera is simulated, or all frames were exposed before")
    assert took_s[0] > 0.5 * exposure_s, (
        f"the first frame came after {took_s[0]:.3f} s, with an exposure of {exposure_s:.3f} s: "
        "it was exposed before it was asked for; drop such frames: see `fpplab.devices.FreeRunningCamera`"
    )


def test_levels_are_right_justified(rig: Rig, camera: Camera) -> None:
    show(rig, WHITE)
    for bits in (bits for bits in camera.caps.bits if 8 < bits < 16):
        camera.configure(replace(settings_of(rig), bits=bits))
        image = camera.snap().image
        assert not image.any() or np.any(image % (1 << (16 - bits))), (
            f"every level is a multiple of {1 << (16 - bits)}: frames of {bits} bits are left-justified; "
            f"shift them to the right, `image >> {16 - bits}`"
        )


@pytest.mark.light
def test_frames_are_what_was_configured(rig: Rig, camera: Camera) -> None:
    show(rig, WHITE)
    for bits in camera.caps.bits:
        settings = camera.configure(replace(settings_of(rig), bits=bits))
        frame = camera.snap()
        width, height = camera.caps.size
        assert frame.image.shape == (height, width)
        assert frame.image.dtype == (np.uint8 if bits == 8 else np.uint16)
        assert frame.image.max() < 1 << bits, f"a grey level has more than {bits} bits: is it left-justified?"
        white = float(frame.image.max()) / (1 << bits)
        assert white > LEAST_WHITE, (
            f"white is at {white:.1%} of full scale at {1e3 * settings.exposure_s:g} ms with {bits} bits: "
            "see light, exposure units, or bits"
        )
        assert frame.settings == settings
        assert frame.index == 0


def test_arming_gives_so_many_frames_and_no_more(rig: Rig, camera: Camera) -> None:
    show(rig, WHITE)
    camera.arm(3)
    for index in range(3):
        assert camera.state is State.ARMED
        assert camera.read(10.0).index == index
    assert camera.state is State.IDLE
    with pytest.raises(StateError):
        camera.read(10.0)
    camera.arm(1)
    assert camera.read(10.0).index == 0


def test_while_armed_nothing_else_is_accepted(rig: Rig, camera: Camera) -> None:
    show(rig, WHITE)
    settings = settings_of(rig)
    camera.arm(2)
    for use in (camera.snap, lambda: camera.arm(1), lambda: camera.configure(settings)):
        with pytest.raises(StateError, match="armed"):
            use()
        assert camera.state is State.ARMED
    assert [camera.read(10.0).index for _ in range(2)] == [0, 1]


@pytest.mark.parametrize("n", [0, -1])
def test_no_frames_cannot_be_asked_for(camera: Camera, n: int) -> None:
    with pytest.raises(SettingError, match=f"n is {n}"):
        camera.arm(n)
    assert camera.state is State.IDLE


@pytest.mark.light
def test_stopping_mid_way_and_arming_again_gives_fresh_frames(rig: Rig, camera: Camera) -> None:
    show(rig, WHITE)
    camera.arm(3)
    white = camera.read(10.0)
    camera.stop()
    assert camera.state is State.IDLE
    rig.projector.show(BLACK)
    camera.arm(3)
    for index in range(3):
        frame = camera.read(10.0)
        assert frame.index == index
        assert brightness(frame.image) < brightness(white.image), "the frame is a stale one"


def test_stopping_is_always_legal(camera: Camera) -> None:
    camera.stop()
    camera.arm(1)
    camera.stop()
    camera.stop()
    assert camera.state is State.IDLE


def test_closing_while_armed_is_legal(camera: Camera) -> None:
    camera.arm(5)
    camera.close()
    assert camera.state is State.CLOSED


def test_a_frame_is_its_owners(rig: Rig, camera: Camera) -> None:
    show(rig, WHITE)
    first = camera.snap()
    kept = first.image.copy()
    later = []
    for i in DISTINCT[1:5]:
        rig.projector.show(i)
        later.append(camera.snap())
    assert not any(np.shares_memory(first.image, frame.image) for frame in later)
    np.testing.assert_array_equal(first.image, kept)


def test_no_picture_comes_twice(rig: Rig, camera: Camera) -> None:
    """Two exposures differ by the noise of the sensor, where those of two armings do."""
    show(rig, GREY)
    once = [camera.snap().image for _ in range(3)]
    if min(np.count_nonzero(one != other) for one, other in pairwise(once)) < NOISY_PX:
        pytest.skip(
            "pictures of one scene are equal: the camera has no noise, or sees all black or all white"
        )
    camera.arm(4)
    images = [camera.read(10.0).image for _ in range(4)]
    for k, (one, other) in enumerate(pairwise(images)):
        assert np.any(one != other), f"frame {k + 1} of one arming is frame {k} again, noise and all"


def test_a_frame_lost_on_the_link_is_a_gap(rig: Rig, camera: Camera) -> None:
    """The camera counts its frames, not the driver: it would give the next frame the lost one's number."""
    if not rig.projector.caps.trigger_outputs or "hardware" not in camera.caps.triggers:
        pytest.skip("there is no hardware trigger")
    if not isinstance(rig.simulation, LosesFrames):
        pytest.skip("only a bench with `lose_frames`, see tests/conformance/bench.py, can lose a frame")
    patterns = patterns_for(rig)[:4]
    rig.projector.load(patterns)
    exposure_s = max(rig.projector.caps.bit_depths[8], settings_of(rig).exposure_s)
    period_s = pulse_timing(camera, rig.projector, patterns, exposure_s).period_s
    camera.arm(4, "hardware")
    rig.projector.play(exposure_s, 0.0, period_s)
    assert camera.read(10.0).index == 0
    rig.simulation.lose_frames(1)
    with pytest.raises(FrameLossError, match="frame 2 arrived instead of frame 1"):
        camera.read(10.0)


def test_time_goes_on(rig: Rig, camera: Camera) -> None:
    show(rig, WHITE)
    before = time.time()
    camera.arm(4)
    frames = [camera.read(10.0) for _ in range(4)]
    host = [before, *(f.host_time_s for f in frames), time.time()]
    assert host == sorted(host)
    device = [f.device_time_s for f in frames if f.device_time_s is not None]
    assert len(device) in (0, 4)
    assert device == sorted(device)


def test_a_trigger_that_it_has_not_is_refused(camera: Camera) -> None:
    for trigger in {"software", "hardware", "telepathic"} - set(camera.caps.triggers):
        with pytest.raises(CapabilityError, match=f"has no {trigger} trigger"):
            camera.arm(1, trigger)  # type: ignore[arg-type]
        assert camera.state is State.IDLE


def test_without_a_pulse_the_hardware_trigger_times_out(camera: Camera) -> None:
    if "hardware" not in camera.caps.triggers:
        with pytest.raises(CapabilityError):
            camera.arm(1, "hardware")
        return
    camera.arm(1, "hardware")
    with pytest.raises(DeviceTimeoutError):
        camera.read(0.1)
    assert camera.state is State.FAULT
    camera.close()
    camera.open()
    assert camera.info()
