"""What a computer's settings do to devices: named where the computer shows it, and only there."""

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from pypylon import genicam

from drivers import computer_settings
from drivers.basler import BaslerCamera, camera
from drivers.computer_settings import claims_of_brltty, filtered_packets, full_sockets, usb_memory
from fpplab.core.errors import DeviceError, StateError
from fpplab.devices import CameraSettings
from tests.drivers.basler_families import KINDS, Kind
from tests.drivers.node_camera import SERIAL, NodeCamera

GIGE = next(kind for kind in KINDS.values() if kind.device_class == "BaslerGigE")
USB = next(kind for kind in KINDS.values() if kind.device_class == "BaslerUsb")
USBFS = "sys/module/usbcore/parameters/usbfs_memory_mb"
Write = Callable[[str, str], None]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Write a file of an empty Linux computer."""
    monkeypatch.setattr(computer_settings, "PROC", tmp_path / "proc")
    monkeypatch.setattr(computer_settings, "SYS", tmp_path / "sys")
    monkeypatch.setattr(computer_settings, "UDEV_RULES", (tmp_path / "rules",))

    def write(name: str, text: str) -> None:
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)

    return write


def test_a_computer_that_shows_nothing_is_not_blamed(write: Write) -> None:
    assert (usb_memory(), filtered_packets(), full_sockets()) == (None, None, None)
    assert not claims_of_brltty(0x1A86, 0x7523)


@pytest.mark.parametrize(("mb", "named"), [("16", True), ("1000", False), ("0", False)])
def test_little_memory_for_usb(write: Write, mb: str, named: bool) -> None:
    write(USBFS, f"{mb}\n")
    sentence = usb_memory()
    assert (sentence is not None) == named
    assert sentence is None or ("have 16 MB of memory" in sentence and "echo 1000 >" in sentence)


@pytest.mark.parametrize(("strict", "dropped"), [(1, 7), (1, 0), (2, 7)])
def test_packets_that_reverse_path_filtering_drops(write: Write, strict: int, dropped: int) -> None:
    write("proc/sys/net/ipv4/conf/eth1/rp_filter", f"{strict}\n")
    write("proc/net/netstat", f"TcpExt: A IPReversePathFilter\nTcpExt: 5 {dropped}\nIpExt: B\nIpExt: 1\n")
    sentence = filtered_packets()
    assert (sentence is not None) == (strict == 1 and dropped > 0)
    assert sentence is None or "7 network packets were dropped" in sentence
    assert sentence is None or "rp_filter is 1 for eth1" in sentence


@pytest.mark.parametrize(("allowed", "dropped"), [(212992, 3), (212992, 0), (1 << 22, 3)])
def test_sockets_without_room(write: Write, allowed: int, dropped: int) -> None:
    write("proc/sys/net/core/rmem_max", f"{allowed}\n")
    write("proc/net/snmp", f"Udp: InDatagrams RcvbufErrors\nUdp: 9 {dropped}\n")
    sentence = full_sockets()
    assert (sentence is not None) == (allowed < 1 << 21 and dropped > 0)
    assert sentence is None or "3 datagrams were dropped" in sentence


def test_brltty_claims_adapters_by_its_rules(write: Write) -> None:
    write("rules/85-brltty.rules", 'ENV{PRODUCT}=="1a86/7523/*", ENV{BRLTTY_BRAILLE_DRIVER}="bm"\n')
    assert claims_of_brltty(0x1A86, 0x7523)
    assert not claims_of_brltty(0x10C4, 0xEA60)


def driver(kind: Kind, end: NodeCamera) -> BaslerCamera:
    return BaslerCamera("camera", {"serial": SERIAL, **kind.options}, SimpleNamespace(pylon=end))


@pytest.mark.parametrize("mb", ["16", "1000"])
def test_a_usb_camera_that_cannot_be_armed_tells_of_little_memory(write: Write, mb: str) -> None:
    def refuse(strategy: object) -> None:
        raise genicam.RuntimeException("Failed to submit transfer. : RuntimeException thrown")

    write(USBFS, mb)
    end = USB.camera()
    end.StartGrabbing = refuse  # type: ignore[method-assign]
    with driver(USB, end) as opened:
        opened.configure(CameraSettings(0.02, bits=8))
        with pytest.raises(DeviceError, match="Failed to submit transfer") as refused:
            opened.arm(3)
    assert ("have 16 MB of memory" in str(refused.value)) == (mb == "16")


@pytest.mark.parametrize(("kind", "tries"), [(GIGE, 3), (USB, 1)])
def test_a_network_camera_is_waited_for_as_a_crash_leaves_it_locked(
    monkeypatch: pytest.MonkeyPatch, kind: Kind, tries: int
) -> None:
    """A program that holds it on, and any that holds a USB camera, is named."""
    asked = []

    def locked(times: int) -> NodeCamera:
        def refuse() -> None:
            asked.append(1)
            if len(asked) <= times:
                raise genicam.RuntimeException("The device is controlled by another application.")

        end = kind.camera()
        end.Open = refuse  # type: ignore[method-assign]
        asked.clear()
        return end

    with driver(kind, locked(tries - 1)):
        assert len(asked) == tries
    monkeypatch.setattr(camera, "LOCKED_S", 0.15)
    with pytest.raises(StateError, match="another program has the camera open; close it there"):
        driver(kind, locked(1000)).open()
    assert (len(asked) > 1) == (kind is GIGE)
