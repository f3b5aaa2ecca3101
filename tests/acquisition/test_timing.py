"""Times of triggered runs, by hand for cameras and projectors of all kinds."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fpplab.acquisition.timing import PeriodLimit, PulseTiming, pulse_timing
from fpplab.core.conventions import Lattice
from fpplab.core.errors import CapabilityError, SettingError
from fpplab.devices import CameraCaps, PatternLoads, ProjectorCaps
from fpplab.patterns.fringes import Pattern

EXPOSURE_S = 0.02
CAMERA = CameraCaps((8, 8), (8,), (1e-4, 1.0), (0.0, 0.0), ("hardware",), period_s=0.0)
FLASH = ProjectorCaps((8, 8), Lattice.DIAMOND, {1: 235e-6, 8: 8333e-6}, 1, 99, 200.0, 231e-6)
VIDEO = replace(FLASH, longest_s=1 / 60, gap_s=0.0)


def timing(
    camera: CameraCaps = CAMERA,
    projector: ProjectorCaps = FLASH,
    bits: tuple[int, ...] = (8,),
    exposure_s: float = EXPOSURE_S,
    loads: PatternLoads = PatternLoads(),  # noqa: B008 - it is frozen
    **more: float,
) -> PulseTiming:
    ends: list[Any] = [
        SimpleNamespace(name=n, caps=c, loads=loads)
        for n, c in (("camera", camera), ("projector", projector))
    ]
    patterns = [Pattern(f"p{b}", np.zeros((8, 8), np.uint8), b) for b in bits]
    return pulse_timing(*ends, patterns, exposure_s, **more)


def test_a_camera_that_is_always_ready_waits_for_nothing() -> None:
    assert timing() == PulseTiming(EXPOSURE_S, 0.0, EXPOSURE_S, PeriodLimit.EXPOSURE)


@pytest.mark.parametrize(("told_s", "period_s"), [(0.025, 0.025), (0.1, 0.1), (0.0201, 0.020231)])
def test_pulses_are_as_far_apart_as_the_camera_tells(told_s: float, period_s: float) -> None:
    """And no nearer than the projector's shortest gap; clocks may differ by 0.2 per mille."""
    found = timing(replace(CAMERA, period_s=told_s))
    assert max(told_s * 1.0002, period_s) == pytest.approx(found.period_s, abs=1e-12)
    assert (found.light_s, found.dark_s) == (EXPOSURE_S, 0.0)


def test_without_a_least_gap_the_cameras_period_alone_counts() -> None:
    found = timing(replace(CAMERA, period_s=0.01605), VIDEO, exposure_s=0.016)
    assert found.period_s == pytest.approx(0.01605 * 1.0002, abs=1e-12)


def test_a_period_that_is_not_told_is_allowed_for() -> None:
    found = timing(replace(CAMERA, period_s=None))
    assert found.period_s == pytest.approx((EXPOSURE_S + 1e-3) * 1.0002, abs=1e-12)


@pytest.mark.parametrize("told_s", [None, 0.0, 0.0201])
def test_a_dead_time_that_is_stated(told_s: float | None) -> None:
    found = timing(replace(CAMERA, period_s=told_s), dead_s=0.004)
    assert found.period_s == pytest.approx(0.024 * 1.0002, abs=1e-12)


def test_a_stated_dead_time_does_not_shorten_what_the_camera_tells() -> None:
    assert timing(replace(CAMERA, period_s=0.05), dead_s=0.004).period_s >= 0.05


def test_a_stated_dead_time_of_none_counts_where_the_camera_tells_nothing() -> None:
    assert timing(replace(CAMERA, period_s=None), dead_s=0.0).period_s == pytest.approx(EXPOSURE_S + 231e-6)


def test_rows_that_begin_one_after_another_see_the_pattern_to_their_end() -> None:
    found = timing(replace(CAMERA, readout_s=0.005))
    assert (found.light_s, found.period_s) == (0.025, 0.025)


def test_rows_that_end_one_after_another_see_darkness() -> None:
    found = timing(replace(CAMERA, dark_s=0.005))
    assert (found.light_s, found.dark_s, found.period_s) == (EXPOSURE_S, 0.005, 0.025)


@pytest.mark.parametrize(
    ("camera", "more", "limit"),
    [
        ({"period_s": 0.03}, {}, PeriodLimit.CAMERA),
        ({"period_s": 0.0201}, {}, PeriodLimit.GAP),
        ({"period_s": None}, {}, PeriodLimit.UNTOLD),
        ({"period_s": 0.03}, {"dead_s": 0.02}, PeriodLimit.STATED),
        ({"period_s": None}, {"dead_s": 0.002}, PeriodLimit.STATED),
        ({"readout_s": 0.005}, {}, PeriodLimit.EXPOSURE),
    ],
)
def test_what_sets_the_period_is_named(
    camera: dict[str, Any], more: dict[str, float], limit: PeriodLimit
) -> None:
    assert timing(replace(CAMERA, **camera), **more).limit is limit


def test_images_that_are_read_from_flash_are_waited_for() -> None:
    found = timing(loads=PatternLoads(12, 0.05))
    assert (found.light_s, found.period_s, found.limit) == (EXPOSURE_S, 0.05, PeriodLimit.LOADS)
    assert timing(replace(CAMERA, period_s=0.1), loads=PatternLoads(12, 0.05)).limit is PeriodLimit.CAMERA


def test_less_than_what_is_asked_for_ends_at_what_the_projector_needs() -> None:
    told = replace(CAMERA, period_s=0.05, dark_s=0.003)
    assert timing(told, gap_s=-0.01).period_s == pytest.approx(0.04, abs=1e-4)
    assert timing(told, gap_s=-1.0).period_s == EXPOSURE_S + 0.003
    assert timing(told, loads=PatternLoads(9, 0.03), gap_s=-1.0).period_s == 0.03


def test_a_global_reset_needs_a_projector_that_can_be_dark() -> None:
    with pytest.raises(CapabilityError, match=r"no dark time .* within 5 ms; use patterns in flash"):
        timing(replace(CAMERA, dark_s=0.005), replace(FLASH, dark_between=False))


def test_a_further_gap_comes_on_top() -> None:
    assert timing(replace(CAMERA, period_s=0.05), gap_s=0.1).period_s == pytest.approx(0.15, abs=1e-4)


@pytest.mark.parametrize(
    ("bits", "exposure_s", "readout_s", "found"),
    [
        ((8,), 0.008, 0.0, r"exposure 8 ms; with 8 bits at least 8\.333 ms: lengthen the plan's exposure_s"),
        ((1, 8, 1), 0.001, 0.002, r"exposure 1 ms and readout 2 ms; with 8 bits at least 8\.333 ms"),
        ((1,), 0.0002, 0.0, r"with 1 bits at least 0\.235 ms"),
    ],
)
def test_patterns_that_would_be_shown_too_briefly(
    bits: tuple[int, ...], exposure_s: float, readout_s: float, found: str
) -> None:
    with pytest.raises(SettingError, match=found):
        timing(replace(CAMERA, readout_s=readout_s), bits=bits, exposure_s=exposure_s)


def test_patterns_that_would_be_shown_for_too_long() -> None:
    with pytest.raises(SettingError, match=r"exposure 16 ms and readout 5 ms; at most 16\.6667 ms: shorten"):
        timing(replace(CAMERA, readout_s=0.005), VIDEO, exposure_s=0.016)


def test_the_shortest_and_the_longest_are_accepted() -> None:
    assert timing(exposure_s=8333e-6).light_s == 8333e-6
    assert timing(projector=VIDEO, exposure_s=1 / 60).light_s == 1 / 60
    assert timing(projector=replace(FLASH, longest_s=math.inf), exposure_s=1e3).light_s == 1e3


def test_a_camera_or_a_projector_without_a_trigger() -> None:
    with pytest.raises(CapabilityError, match="camera: arm: has no hardware trigger; use a stepped plan"):
        timing(replace(CAMERA, triggers=("software",)))
    with pytest.raises(CapabilityError, match="projector: play: has no trigger output; use a stepped plan"):
        timing(projector=replace(FLASH, trigger_outputs=0))
