"""What looking for connected devices finds; drivers bring the looking by entry points."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from fpplab.devices.device import DeviceInfo


@dataclass(frozen=True)
class FoundDevices:
    """Connected devices, and why others may not show.

    Attributes
    ----------
    devices : list of DeviceInfo
        What is connected.
    missing : list of str
        A sentence for everything that keeps devices from showing: a library, a permission.
    """

    devices: list[DeviceInfo]
    missing: list[str]

    @classmethod
    def together(cls, found: Iterable[FoundDevices]) -> FoundDevices:
        """Join what several drivers have found.

        Parameters
        ----------
        found : iterable of FoundDevices
            In the order in which it is to be listed.

        Returns
        -------
        FoundDevices
            All of it.
        """
        parts = list(found)
        return cls([d for part in parts for d in part.devices], [m for part in parts for m in part.missing])
