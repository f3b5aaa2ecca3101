"""A fixture that is a person: asks for each item and pose at the terminal.

fixture: {backend: "fpplab.devices.operator:Operator"}
"""

from __future__ import annotations

import sys

from fpplab.core.errors import DeviceError
from fpplab.devices import DeviceInfo, Fixture, FixtureCaps


class Operator(Fixture):
    """Asks on stderr and waits for Enter on stdin."""

    def _open(self) -> None:
        if not sys.stdin.isatty():
            raise DeviceError(
                self.name, "open", "there is nobody at the terminal", "run this command in a terminal"
            )

    def _close(self) -> None:
        """A person needs no closing."""

    def _info(self) -> DeviceInfo:
        return DeviceInfo("fixture", "operator", "", "terminal")

    def _caps(self) -> FixtureCaps:
        return FixtureCaps()

    def _mount(self, item: str, pose: int) -> None:
        ask = "Take everything away" if item == "nothing" else f"Put {item} in pose {pose + 1}"
        sys.stderr.write(f"{ask} in front of the rig, then press Enter: ")
        sys.stderr.flush()
        if not sys.stdin.readline():
            raise DeviceError(self.name, "mount", "the terminal was closed", "run the command again")
