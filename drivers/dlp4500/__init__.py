"""The DLP LightCrafter 4500 and its controller, the DLPC350, over USB HID.

`framing` and `protocol` are the packets as pure functions, `transport` matches questions and answers,
`sequence` knows planes and times, `controller` gives the orders, `device` is the projector of a rig.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.dlp4500.device import Dlp4500

__all__ = ["Dlp4500"]


def __getattr__(name: str) -> Any:
    """The projector, once it is asked for: the command line knows this package's commands without it."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from drivers.dlp4500 import device

    return getattr(device, name)
