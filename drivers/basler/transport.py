"""Access to pylon's transport layers; an emulated bench substitutes its own."""

from contextlib import suppress
from typing import Any

from pypylon import genicam, pylon


class Pylon:
    """Every camera that pylon's transport layers list: USB3 Vision, GigE Vision and its own emulator."""

    def cameras(self) -> dict[str, Any]:
        """List the cameras that are connected now, opened or not."""
        return {info.GetSerialNumber(): info for info in self._layer().EnumerateDevices()}

    def attach(self, info: Any) -> Any:
        """Create pylon's handle of a camera."""
        return pylon.InstantCamera(pylon.TlFactory.GetInstance().CreateDevice(info))

    def _layer(self) -> Any:
        return pylon.TlFactory.GetInstance()


LOST = {
    "packets lost": "Statistic_Failed_Packet_Count",
    "packets sent again": "Statistic_Resend_Packet_Count",
    "frames damaged": "Statistic_Failed_Buffer_Count",
    "frames without a buffer": "Statistic_Buffer_Underrun_Count",
    "frames missed": "Statistic_Missed_Frame_Count",
}
"""Nodes by what they count since frames were last awaited; each link has some of them."""


def lost_on_link(nodes: Any) -> dict[str, int]:
    counts: dict[str, int] = {}
    with suppress(genicam.GenericException):  # an unplugged camera; that is reported by its own error
        for what, name in LOST.items():
            node = nodes.GetNode(name)
            if node.IsValid() and node.IsReadable() and (count := node.GetValue()) > 0:
                counts[what] = count
    return counts
