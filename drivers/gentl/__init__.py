"""Driver of any GenICam camera through a GenTL producer, the .cti file of the maker's software."""

from typing import TYPE_CHECKING, Any

from fpplab.core.extras import how_to_install

if TYPE_CHECKING:
    from drivers.gentl.camera import GentlCamera

__all__ = ["GentlCamera"]


def __getattr__(name: str) -> Any:
    """Import the camera class when it is first accessed; its library is an optional package."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        from drivers.gentl import camera
    except ModuleNotFoundError as error:
        raise ImportError(how_to_install(error.name or "genicam"), name=error.name) from error

    return getattr(camera, name)
