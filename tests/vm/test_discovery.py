"""The projector as the kernel, libusb and hidapi list it, and who may open it."""

import grp
import os
from pathlib import Path

import hid
import hidraw
import usb.core

from drivers.dlp4500.transport import PRODUCT, VENDOR
from tests.support.commands import run
from tests.vm.conftest import is_gone, is_on_usb, wait_until
from tests.vm.projector import Projector

SERIAL = "LCR3"


def test_both_interfaces_show_in_hidapi(emulated: Projector) -> None:
    for library in (hid, hidraw):
        found = library.enumerate(VENDOR, PRODUCT)
        assert {one["interface_number"] for one in found} == {0, 1}
        assert {one["serial_number"] for one in found} == {SERIAL}


def test_pyusb_tells_speed_and_names(emulated: Projector) -> None:
    device = usb.core.find(idVendor=VENDOR, idProduct=PRODUCT)
    assert device.speed == 2, "12 Mbit/s in libusb's numbers"
    assert (device.manufacturer, device.product, device.serial_number) == (
        "Texas Instruments", "DLPC350", SERIAL,
    )  # fmt: skip
    endpoints = [{e.bEndpointAddress for e in interface} for interface in device[0]]
    assert endpoints == [{0x81, 0x01}, {0x82, 0x02}]


def test_the_command_lists_it(emulated: Projector) -> None:
    found = run("devices", "--json").json
    (projector,) = (device for device in found["devices"] if device["kind"] == "projector")
    assert (projector["model"], projector["serial"]) == ("DLPC350", SERIAL)
    assert projector["link"].endswith("USB 1, 12 Mbit/s")
    assert not [sentence for sentence in found["missing"] if "projector" in sentence]


def test_an_unplugged_one_is_not_listed(emulated: Projector) -> None:
    emulated.unplug()
    wait_until(is_gone)
    wait_until(lambda: usb.core.find(idVendor=VENDOR, idProduct=PRODUCT) is None)
    assert not hidraw.enumerate(VENDOR, PRODUCT)
    emulated.plug()
    wait_until(is_on_usb)


def test_the_documented_rules_give_it_to_their_group(emulated: Projector) -> None:
    """As the documentation says for remote work: GROUP and MODE behind each rule."""
    device = usb.core.find(idVendor=VENDOR, idProduct=PRODUCT)
    nodes = [Path(f"/dev/bus/usb/{device.bus:03d}/{device.address:03d}"), *Path("/dev").glob("hidraw*")]
    assert len(nodes) == 3
    wait_until(lambda: all(node.stat().st_mode & 0o777 == 0o660 for node in nodes))
    assert {grp.getgrgid(os.stat(node).st_gid).gr_name for node in nodes} == {"plugdev"}
