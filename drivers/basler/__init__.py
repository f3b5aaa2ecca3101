"""Basler cameras through pylon.

What is proven of this package is proven on pylon's own camera emulator and on GenICam node maps, not on a
camera; docs/hardware.md says what to look at when one is connected.
"""

from __future__ import annotations

from drivers.basler.camera import BaslerCamera

__all__ = ["BaslerCamera"]
