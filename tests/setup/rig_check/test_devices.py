"""Permissions, the camera's link, the disk and the mains, told by `check`."""

from pathlib import Path

import numpy as np
import pytest

from fpplab.core.conventions import Floats
from fpplab.core.errors import DeviceError
from fpplab.devices import CameraSettings, DeviceInfo
from fpplab.diagnosis.causes.of_rig_check import DEVICE, MAINS_FLICKER, NO_PERMISSION, SLOW_DISK, SLOW_LINK
from fpplab.patterns.plan import Plan
from fpplab.setup.rig_check import devices
from fpplab.setup.rig_check.check import check_rig
from fpplab.setup.rig_check.devices import device_finding, disk_finding, link_finding
from tests.support.faulty_rig import drawn, formula_rig
from tests.support.recorded import PLAN, image_of


def link(how: str) -> DeviceInfo:
    return DeviceInfo("camera", "ace", "1", how)


def test_usb_2_carries_eight_frames_of_five_megabytes_per_second() -> None:
    found = link_finding(link("BaslerUsb, USB 2, 480 Mbit/s"), 5e6, 0.03)
    assert found is not None
    assert found.cause == SLOW_LINK
    assert "8.0 frames" in found.evidence
    assert link_finding(link("BaslerUsb, USB 2, 480 Mbit/s"), 5e6, 0.2) is None
    assert link_finding(link("BaslerUsb, USB 3, 5 Gbit/s"), 5e6, 0.03) is None
    assert link_finding(link("memory"), 5e6, 0.03) is None


@pytest.mark.parametrize(
    "found", ["no permission to use /dev/ttyUSB0", "[Errno 13] Permission denied", "Access denied"]
)
def test_a_refusal_is_a_lack_of_permission(found: str) -> None:
    assert device_finding(DeviceError("stage", "open", found)).cause == NO_PERMISSION
    assert device_finding(DeviceError("stage", "open", "no answer")).cause == DEVICE


def test_a_disk_is_slow_where_frames_come_faster_than_it_takes_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    triggered, settings = PLAN.model_copy(update={"trigger": "triggered"}), CameraSettings(0.02, 0.0, 8)

    def found(plan: Plan, period_s: float) -> object:
        return disk_finding(tmp_path, plan, image_of(0), settings, period_s)

    assert found(triggered, 60.0) is None
    assert found(PLAN, 1e-6) is None
    slow = disk_finding(tmp_path, triggered, image_of(0), settings, 1e-6)
    assert slow is not None
    assert slow.cause == SLOW_DISK
    assert list(tmp_path.iterdir()) == []


def causes(cause: str, seed: int) -> list[str]:
    bench = drawn(cause, seed)
    found = check_rig(formula_rig(cause, seed), bench.plan, "card", lambda _: None, bench.calibration)
    return [one.cause.key for one in found.findings]


def test_a_missing_colour_is_no_slip() -> None:
    assert causes("missing_colour", 201) == ["missing_colour"]


@pytest.mark.whole
def test_light_of_the_mains_is_told_from_random_light() -> None:
    assert causes("mains_flicker", 201)[0] == "mains_flicker"
    assert causes("flicker", 201)[0] == "flicker"


def test_the_mains_are_named_by_how_much_whole_periods_calm_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a lamp at 100 Hz, an exposure sees the mean over its time: a ripple times sin(πfT)/πfT."""

    def levels(_rig: object, _plan: Plan, exposure_s: float) -> Floats:
        starts = 2 * np.pi * np.arange(devices.LIMITS.frames) / devices.LIMITS.frames
        return np.asarray(1e4 * exposure_s * (1 + 0.3 * np.sinc(100.0 * exposure_s) * np.cos(starts)))

    monkeypatch.setattr(devices, "_mean_frame_levels", levels)
    with formula_rig(None, 3) as rig:
        found = devices.mains_finding(rig, PLAN.model_copy(update={"exposure_s": 0.013}))
    assert found is not None
    assert found.cause == MAINS_FLICKER
    assert "`exposure_s: 0.01`" in found.remedy
    restless = 0.3 * abs(np.sinc(1.3)) / np.sqrt(2.0)
    assert found.excess == pytest.approx(restless / devices.LIMITS.min_mains_scatter, rel=0.05)


def test_random_light_is_as_restless_with_whole_periods(monkeypatch: pytest.MonkeyPatch) -> None:
    random = np.random.default_rng(2)
    monkeypatch.setattr(devices, "_brightness_scatter", lambda *_: 0.05 * random.uniform(0.8, 1.2))
    with formula_rig(None, 3) as rig:
        assert devices.mains_finding(rig, PLAN) is None
