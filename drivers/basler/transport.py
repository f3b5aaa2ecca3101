"""Where cameras come from: pylon itself, or what stands in for it on an emulated bench."""

from __future__ import annotations

from typing import Any

from pypylon import pylon


class Pylon:
    """Every camera that pylon's transport layers see: USB3 Vision, GigE Vision, its own emulator."""

    def cameras(self) -> dict[str, Any]:
        """Pylon's `DeviceInfo` of each camera that is connected now, opened or not, by serial number."""
        return {found.GetSerialNumber(): found for found in self._layer().EnumerateDevices()}

    def attach(self, info: Any) -> Any:
        """The `InstantCamera` of one of `cameras`, not open yet.

        Raises pylon's own `GenericException` when it cannot be reached or another program has it.
        """
        return pylon.InstantCamera(pylon.TlFactory.GetInstance().CreateDevice(info))

    def _layer(self) -> Any:
        return pylon.TlFactory.GetInstance()
