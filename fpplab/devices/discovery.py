"""Results of looking for connected devices; drivers provide the search by entry points."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from fpplab.core import plugins
from fpplab.devices.device import DeviceInfo

COMPUTER = "computer: "
"""Beginning of sentences about settings of the computer that keep devices from working."""


@dataclass(frozen=True)
class FoundDevice(DeviceInfo):
    """A device that is connected, and how a rig file would name it."""

    section: Mapping[str, Any] = field(default_factory=dict)  # of a rig file; empty where no driver opens it
    example: str = ""  # rig file that comes with fpplab and has such a device
    is_certain: bool = True
    """Otherwise it is used only if it is named: any device may be at a serial port, and the main display is
    the operator's."""

    @property
    def title(self) -> str:
        serial = f", serial number {self.serial}" if self.serial else ""
        return f"{self.model}{serial} ({self.link})"

    def is_called(self, name: str) -> bool:
        return name in {self.serial, self.model, self.link, *map(str, self.section.values())} - {""}


@dataclass(frozen=True)
class FoundDevices:
    """Connected devices, and why others may not show."""

    devices: list[FoundDevice]
    missing: list[str]
    """A sentence for all that keeps devices from being listed or from working: a library, a permission."""


def connected_devices() -> FoundDevices:
    """Look for devices by all drivers that are installed, in the order in which they are to be listed."""
    parts = [
        plugins.load_plugin(plugins.DISCOVERY, name)() for name in plugins.plugin_names(plugins.DISCOVERY)
    ]
    return FoundDevices(
        [d for part in parts for d in part.devices], [m for part in parts for m in part.missing]
    )
