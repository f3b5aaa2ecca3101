"""Driver of any projector with a display input, over HDMI or as a second screen."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.display.device import DisplayProjector

__all__ = ["DisplayProjector"]


def __getattr__(name: str) -> Any:
    """Import the projector class when it is first accessed, so that the command line starts without it."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from drivers.display import device

    return getattr(device, name)
