"""Driver of the DLP LightCrafter 4500 and its controller, the DLPC350, over USB HID."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.dlp4500.device import Dlp4500

__all__ = ["Dlp4500"]


def __getattr__(name: str) -> Any:
    """Import the projector class when it is first accessed, so that the command line starts without it."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from drivers.dlp4500 import device

    return getattr(device, name)
