"""A fixture that is a person: asks for each item and pose at the terminal.

fixture: {backend: "fpplab.operator:Operator"}
"""

from __future__ import annotations

import sys
from typing import Any

from fpplab.devices import DeviceInfo, Fixture, FixtureCaps
from fpplab.errors import DeviceError
from fpplab.geometry import RigidTransform


class AnyItem(dict[str, int | None]):
    """A person can put up whatever they are asked for, in as many poses as wanted."""

    def __contains__(self, item: object) -> bool:
        return isinstance(item, str)

    def __getitem__(self, item: str) -> int | None:
        return None


class Operator(Fixture):
    """Asks on stderr and waits for Enter on stdin."""

    def _setup(self, options: dict[str, Any], bench: Any) -> None:
        super()._setup(options, bench)

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
        return FixtureCaps(AnyItem())

    def _mount(self, item: str, pose: int) -> None:
        where = f" in pose {pose + 1}" if pose or item not in ("nothing", "grey_card") else ""
        sys.stderr.write(f"Put {item}{where} in front of the rig, then press Enter: ")
        sys.stderr.flush()
        if not sys.stdin.readline():
            raise DeviceError(self.name, "mount", "the terminal was closed", "run the command again")

    def _pose(self, item: str, pose: int) -> RigidTransform | None:
        return None
