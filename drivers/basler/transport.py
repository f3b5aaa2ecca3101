"""Access to pylon's transport layers; an emulated bench substitutes its own."""

from __future__ import annotations

from typing import Any

from pypylon import pylon


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
