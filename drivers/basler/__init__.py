"""Basler cameras through pylon.

What is proven of this package is proven on pylon's own camera emulator and on GenICam node maps, not on a
camera; docs/hardware.md says what to look at when one is connected.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.basler.camera import BaslerCamera

__all__ = ["BaslerCamera"]


def __getattr__(name: str) -> Any:
    """The camera, once it is asked for: the command line knows this package's commands without pylon."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from drivers.basler import camera

    return getattr(camera, name)
