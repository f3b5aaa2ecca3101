"""Plugins: what installed packages add to fpplab by entry points, whose groups are the constants below."""

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from fpplab.core.errors import ConfigError
from fpplab.core.extras import missing_extra

COMMANDS = "fpplab.commands"
"""`typer.Typer` programs, added to the command line under the entry's name.

A program of one command without a callback is added as that command, under the heading or the group that it
names."""

BACKENDS = "fpplab.backends"
"""Classes of devices and benches that rig files may name, by the entry's name or its `module:Class`."""

EMULATORS = "fpplab.emulators"
"""Context managers that serve a device until they end and give how to use it, a `dict[str, str]`.

One that takes a firmware file has a parameter `firmware: Path | None = None`."""

DISCOVERY = "fpplab.discovery"
"""Functions without arguments that look for devices and return `fpplab.devices.discovery.FoundDevices`."""


@cache
def find_entries(group: str) -> dict[str, EntryPoint]:
    # Each search reads the records of every package that is installed.
    return {entry.name: entry for entry in entry_points(group=group)}


def plugin_names(group: str) -> list[str]:
    return sorted(find_entries(group))


def load_plugin(group: str, name: str) -> Any:
    kind = group.rpartition(".")[2].removesuffix("s")
    entry = find_entries(group).get(name)
    if entry is None:
        available = ", ".join(plugin_names(group)) or "none; reinstall fpplab, its entry points are missing"
        raise ConfigError(f"there is no {kind} '{name}'; there are {available}")
    try:
        return entry.load()
    except (ImportError, AttributeError) as error:
        if missing := missing_extra(error):
            raise missing from error
        raise ConfigError(f"the {kind} '{name}' cannot be loaded ({error})") from error
