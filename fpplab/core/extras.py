"""Extras: parts of fpplab whose packages are installed only on request, such as `fpplab[viewer]`."""

from __future__ import annotations

from importlib.util import find_spec

from fpplab.core.errors import ConfigError

EXTRAS = {
    "twin": ("bpy", "skimage"),
    "basler": ("pypylon",),
    "lightcrafter": ("hid", "usb"),
    "stage": ("serial",),
    "display": ("sdl2",),
    "gentl": ("genicam", "harvesters"),
    "viewer": ("rerun", "rerun_cli", "pyarrow"),
    "files": ("pye57", "laspy", "lxml"),
    "optimise": ("optuna", "distributed", "dask"),
    "service": ("fastapi", "fastapi_offline", "starlette", "uvicorn"),
}


class MissingExtraError(ConfigError):
    """A package of an extra is not installed."""

    def __init__(self, module: str) -> None:
        self.module = module
        super().__init__(how_to_install(module))

    def __reduce__(self) -> tuple[type[MissingExtraError], tuple[str]]:
        """Pickle by the argument, since errors also come from other processes."""
        return type(self), (self.module,)


def extra_of(module: str) -> str:
    first = module.partition(".")[0]
    return next((extra for extra, modules in EXTRAS.items() if first in modules), "")


def how_to_install(module: str) -> str:
    first = module.partition(".")[0]
    extra = extra_of(module)
    requirement = f"'fpplab[{extra}]'" if extra else first
    return f"{first} is not installed; install it with: pip install {requirement}"


def missing_extra(error: BaseException) -> MissingExtraError | None:
    if isinstance(error, ModuleNotFoundError) and error.name and extra_of(error.name):
        return MissingExtraError(error.name)
    return None


def need_extra(module: str) -> None:
    if find_spec(module) is None:
        raise MissingExtraError(module)
