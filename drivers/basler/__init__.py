"""Driver of Basler cameras, through pylon."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drivers.basler.camera import BaslerCamera

__all__ = ["BaslerCamera"]


def __getattr__(name: str) -> Any:
    """Import the camera class when it is first accessed, so that the command line starts without pylon."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from drivers.basler import camera

    return getattr(camera, name)
