"""What the devices of one rig share, where they share anything: a world, a recording, an emulated wire."""

from __future__ import annotations

from typing import Protocol, runtime_checkable


@runtime_checkable
class SharedBackend(Protocol):
    """What a rig file's `bench` names; made as `Backend(options)` and handed to every device.

    `options` is the rest of the section, a `dict[str, Any]`; a wrong one is a `ConfigError` on construction.
    What else it can do is said by the Protocols of `fpplab.simulation`.
    """

    def open(self) -> None:
        """Get ready; called once, before any of the devices is opened.

        Raises
        ------
        ConfigError, DeviceError
            It cannot be had; nothing is left open then.
        """
        ...

    def close(self) -> None:
        """Let go of everything; called after all devices are closed, whatever failed, any number of times."""
        ...
