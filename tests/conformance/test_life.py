"""Opening, closing and failing, the same for every kind of device."""

from collections.abc import Callable
from typing import Any

import pytest

from fpplab.core.errors import DeviceError, NotOpenError, StateError
from fpplab.devices import CameraSettings, Device, State
from fpplab.devices.rig import Rig
from tests.conformance.bench import check_unknown_key

Use = Callable[[Any], object]

USES: dict[str, dict[str, Use]] = {
    "camera": {
        "caps": lambda d: d.caps,
        "configure": lambda d: d.configure(CameraSettings(0.01)),
        "arm": lambda d: d.arm(1),
        "read": lambda d: d.read(1.0),
        "stop": lambda d: d.stop(),
        "snap": lambda d: d.snap(),
    },
    "projector": {
        "caps": lambda d: d.caps,
        "load": lambda d: d.load([]),
        "show": lambda d: d.show(0),
        "play": lambda d: d.play(0.1),
        "blank": lambda d: d.blank(),
    },
    "stage": {
        "caps": lambda d: d.caps,
        "home": lambda d: d.home(),
        "move_to": lambda d: d.move_to(1.0),
        "position_mm": lambda d: d.position_mm,
        "halt": lambda d: d.halt(),
    },
    "fixture": {"caps": lambda d: d.caps, "mount": lambda d: d.mount("nothing")},
}
"""Everything that needs an open device."""


def uses(device: Device) -> dict[str, Use]:
    return {"info": lambda d: d.info(), **USES[device.kind]}


def test_an_unknown_key_of_its_section_is_refused(rig: Rig, device: Device) -> None:
    check_unknown_key(rig, device)


def test_everything_before_opening_is_refused(device: Device) -> None:
    device.close()
    for name, use in uses(device).items():
        with pytest.raises(NotOpenError, match="is not open"):
            use(device)
        assert device.state is State.CLOSED, name


def test_opening_twice_is_refused_and_does_no_harm(device: Device) -> None:
    with pytest.raises(StateError, match="already"):
        device.open()
    assert device.state is State.IDLE
    assert device.info()


def test_closing_is_legal_any_number_of_times(device: Device) -> None:
    for _ in range(3):
        device.close()
        assert device.state is State.CLOSED


def test_it_can_be_opened_again(device: Device) -> None:
    for _ in range(2):
        device.close()
        device.open()
        assert device.state is State.IDLE
        assert device.info()


def test_with_opens_and_closes_also_when_the_block_fails(device: Device) -> None:
    device.close()
    with device:
        assert device.state is State.IDLE
    assert str(device.state) == "closed"
    with pytest.raises(ZeroDivisionError), device:
        _ = 1 / 0
    assert str(device.state) == "closed"


def test_it_says_what_it_is(device: Device) -> None:
    info = device.info()
    assert info.kind == device.kind
    assert info.model


def test_a_foreign_exception_becomes_a_device_error_and_a_fault(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise OSError("the cable is gone")

    monkeypatch.setattr(device, "_info", broken)
    with pytest.raises(DeviceError, match=r"info: OSError: the cable is gone") as caught:
        device.info()
    assert isinstance(caught.value.__cause__, OSError)
    assert device.state is State.FAULT


def test_a_device_in_fault_can_only_be_closed(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object) -> None:
        raise OSError("the cable is gone")

    with monkeypatch.context() as patch:
        patch.setattr(device, "_info", broken)
        with pytest.raises(DeviceError):
            device.info()
    for name, use in uses(device).items():
        with pytest.raises(StateError, match="is in fault"):
            use(device)
        assert device.state is State.FAULT, name
    with pytest.raises(StateError, match="is fault already"):
        device.open()
    device.close()
    device.open()
    assert device.state is State.IDLE


def test_a_failed_opening_leaves_it_closed_and_fit_for_another(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken() -> None:
        raise OSError("nobody answers")

    device.close()
    with monkeypatch.context() as patch:
        patch.setattr(device, "_open", broken)
        with pytest.raises(DeviceError, match="nobody answers"):
            device.open()
    assert device.state is State.CLOSED
    device.open()
    assert device.info()


def test_it_is_closed_even_when_closing_fails(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    really_close = device._close

    def broken() -> None:
        really_close()
        raise OSError("lost on the way")

    with monkeypatch.context() as patch:
        patch.setattr(device, "_close", broken)
        with pytest.raises(DeviceError, match="lost on the way"):
            device.close()
    assert device.state is State.CLOSED
