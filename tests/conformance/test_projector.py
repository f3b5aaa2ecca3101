"""What every projector does, and what it refuses."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fpplab.acquisition.timing import pulse_timing
from fpplab.core.errors import CapabilityError, SettingError, StateError
from fpplab.devices import Camera, Projector, State
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import Pattern
from tests.conformance.bench import (
    BLACK,
    DISTINCT,
    GREY,
    WHITE,
    brightness,
    dark_now,
    is_dark,
    patterns_for,
    picture,
    seen,
)


def test_caps_make_sense(projector: Projector) -> None:
    caps = projector.caps
    assert caps.size[0] > 1
    assert caps.size[1] > 1
    assert caps.bit_depths
    assert all(1 <= bits <= 8 and least >= 0 for bits, least in caps.bit_depths.items())
    assert caps.trigger_outputs >= 0
    assert caps.max_patterns >= 1


def test_loading_returns_what_will_be_shown(rig: Rig, projector: Projector) -> None:
    asked = patterns_for(rig)
    shown = projector.load(asked)
    assert [p.id for p in shown] == [p.id for p in asked]
    for pattern, given in zip(shown, asked, strict=True):
        assert pattern.image.shape == given.image.shape
        assert pattern.image.dtype == np.uint8
        step = 255 / ((1 << pattern.bit_depth) - 1)
        assert np.abs(pattern.image.astype(float) - given.image).max() <= step / 2 + 0.5
        assert len(np.unique(pattern.image)) <= 1 << pattern.bit_depth
    again = projector.load(shown)
    assert all(np.array_equal(a.image, b.image) for a, b in zip(again, shown, strict=True))


def test_fewer_bits_are_quantised(rig: Rig, projector: Projector) -> None:
    ramp = patterns_for(rig)[4]
    for bits in set(projector.caps.bit_depths) - {8}:
        (shown,) = projector.load([replace(ramp, bit_depth=bits)])
        assert shown.bit_depth == bits
        assert 2 <= len(np.unique(shown.image)) <= 1 << bits


def refused(rig: Rig) -> dict[str, list[Pattern]]:
    """Loads that no projector takes; the first patterns of each are good."""
    good, caps = patterns_for(rig)[:2], rig.projector.caps
    image = good[0].image
    bad: dict[str, Any] = {
        "transposed": np.zeros((caps.size[0], caps.size[1] + 1), np.uint8),
        "too narrow": image[:, :-1],
        "too low": image[:-1],
        "coloured": np.zeros((*image.shape, 3), np.uint8),
        "16 bits": image.astype(np.uint16),
        "floats": image / 255.0,
    }
    loads = {name: [*good, Pattern(name, array)] for name, array in bad.items()}
    depths = {f"{bits} bits": bits for bits in range(10) if bits not in caps.bit_depths}
    loads |= {name: [*good, replace(good[0], bit_depth=bits)] for name, bits in depths.items()}
    return loads | {"none": [], "too many": good * caps.max_patterns}


def test_a_wrong_load_is_refused_whole(rig: Rig, camera: Camera, projector: Projector) -> None:
    patterns = patterns_for(rig)
    projector.load([patterns[WHITE], patterns[BLACK]])
    for name, load in refused(rig).items():
        with pytest.raises((SettingError, CapabilityError), match="load"):
            projector.load(load)
        assert projector.state is State.IDLE, name
        with pytest.raises(SettingError):
            projector.show(2)
    assert brightness(picture(rig, 0)) > brightness(picture(rig, 1)), "the patterns loaded before stay"


def test_only_what_is_loaded_can_be_shown(rig: Rig, projector: Projector) -> None:
    with pytest.raises(SettingError, match="0 are loaded"):
        projector.show(0)
    patterns = patterns_for(rig)[:3]
    projector.load(patterns)
    for i in (-1, 3):
        with pytest.raises(SettingError, match=f"pattern {i} was asked for"):
            projector.show(i)
    assert projector.state is State.IDLE


def test_what_is_shown_is_what_the_camera_sees(rig: Rig, camera: Camera, projector: Projector) -> None:
    projector.load(patterns_for(rig))
    first = {i: picture(rig, i) for i in DISTINCT}
    noise = float(np.abs(picture(rig, WHITE) - first[WHITE]).mean())
    least = max(0.02, 10 * noise)
    white, grey, black = (brightness(p) for p in (first[WHITE], picture(rig, GREY), first[BLACK]))
    assert white > grey + least
    assert grey > black + least
    for i in reversed(DISTINCT):
        again = picture(rig, i)
        distance = {k: float(np.abs(again - known).mean()) for k, known in first.items()}
        assert min(distance, key=distance.__getitem__) == i


@pytest.mark.parametrize("first", [4, 8])
def test_stripes_light_a_part_and_leave_a_part_dark(
    rig: Rig, camera: Camera, projector: Projector, first: int
) -> None:
    """Steps 0 and 2 are each other's negative: dark where the other is bright."""
    projector.load(patterns_for(rig))
    swing = picture(rig, WHITE) - picture(rig, BLACK)
    lit = swing > 0.5 * swing.max()
    difference = (picture(rig, first) - picture(rig, first + 2))[lit] / swing[lit]
    assert difference.max() > 0.3
    assert difference.min() < -0.3


def test_patterns_follow_their_order_in_the_load(rig: Rig, camera: Camera, projector: Projector) -> None:
    patterns = patterns_for(rig)
    projector.load([patterns[BLACK], patterns[WHITE]])
    dark, bright = picture(rig, 0), picture(rig, 1)
    projector.load([patterns[WHITE], patterns[BLACK]])
    assert brightness(bright) > brightness(dark)
    assert brightness(picture(rig, 0)) > brightness(picture(rig, 1))


def test_a_frame_names_what_was_on_show(rig: Rig, camera: Camera, projector: Projector) -> None:
    """A backend that knows the pattern names the right one; one that does not know names none."""
    patterns = patterns_for(rig)
    projector.load(patterns)
    for i in (4, 1):
        projector.show(i)
        assert camera.snap().pattern_id in (None, patterns[i].id)


def test_blank_is_dark(rig: Rig, camera: Camera, projector: Projector) -> None:
    assert is_dark(rig)
    projector.blank()
    assert projector.state is State.IDLE


def test_closing_is_dark(rig: Rig, camera: Camera, projector: Projector) -> None:
    projector.load(patterns_for(rig))
    black, white = brightness(picture(rig, BLACK)), brightness(picture(rig, WHITE))
    projector.close()
    assert dark_now(rig, black, white)


def test_after_reopening_nothing_is_loaded(rig: Rig, projector: Projector) -> None:
    projector.load(patterns_for(rig))
    projector.close()
    projector.open()
    with pytest.raises(SettingError, match="0 are loaded"):
        projector.show(0)


def test_what_is_loaded_is_a_copy(rig: Rig, camera: Camera, projector: Projector) -> None:
    patterns = patterns_for(rig)
    loaded = projector.load([patterns[WHITE], patterns[BLACK]])
    before = [picture(rig, i) for i in range(2)]
    told = [p.image.copy() for p in loaded]
    for i in (WHITE, BLACK):
        patterns[i].image[:] = 255 - patterns[i].image
    after = [picture(rig, i) for i in range(2)]
    assert brightness(after[0]) - brightness(after[1]) > 0.5 * (brightness(before[0]) - brightness(before[1]))
    assert all(np.array_equal(p.image, t) for p, t in zip(loaded, told, strict=True))


def test_playing_needs_a_trigger_output(rig: Rig, projector: Projector) -> None:
    projector.load(patterns_for(rig))
    if projector.caps.trigger_outputs:
        projector.play(projector.caps.bit_depths[8])
        assert projector.state is State.ARMED
    else:
        with pytest.raises(CapabilityError, match="no trigger output"):
            projector.play(1.0)
        assert projector.state is State.IDLE


def test_playing_needs_patterns_and_time(rig: Rig, projector: Projector) -> None:
    with pytest.raises((StateError, CapabilityError), match="play"):
        projector.play(1.0)
    least = projector.caps.bit_depths[8]
    projector.load(patterns_for(rig))
    for exposure_s in (math.nextafter(least, -1.0), math.nan):
        with pytest.raises((SettingError, CapabilityError), match="play"):
            projector.play(exposure_s)
    for dark_s in (-1e-9, math.nan):
        with pytest.raises((SettingError, CapabilityError), match="play"):
            projector.play(least, dark_s)
        with pytest.raises((SettingError, CapabilityError), match="play"):
            projector.play(least, 0.0, dark_s)
    assert projector.state is State.IDLE


def test_played_patterns_come_one_by_one_and_in_order(rig: Rig, camera: Camera, projector: Projector) -> None:
    projector.load(patterns_for(rig))
    exposure_s = max(projector.caps.bit_depths[8], rig.camera_settings(0.02).exposure_s)
    if not projector.caps.trigger_outputs or "hardware" not in camera.caps.triggers:
        with pytest.raises(CapabilityError):
            _ = camera.arm(4, "hardware"), projector.play(exposure_s)
        return
    still = [picture(rig, i) for i in range(4)]
    projector.load(patterns_for(rig)[:4])
    camera.arm(4, "hardware")
    projector.play(exposure_s, 0.0, pulse_timing(camera, projector, patterns_for(rig), exposure_s).period_s)
    for refused in (lambda: projector.show(0), lambda: projector.load([]), lambda: projector.play(1.0)):
        with pytest.raises(StateError, match="armed"):
            refused()
    full = float((1 << rig.file.camera.bits) - 1)
    played = [camera.read(10.0).image / full for _ in range(4)]
    assert [np.argmin([np.abs(p - s).mean() for s in still]) for p in (played[0], played[2])] == [0, 2]
    projector.blank()
    assert projector.state is State.IDLE
    assert brightness(seen(rig)) < 0.5 * brightness(still[WHITE])
