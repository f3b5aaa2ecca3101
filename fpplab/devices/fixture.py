"""The fixture."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import final

from fpplab.core.errors import SettingError
from fpplab.core.geometry import RigidTransform
from fpplab.devices.device import Device, State


@dataclass(frozen=True)
class FixtureCaps:
    """What a fixture can hold: for each item, in how many poses (None: as many as wanted).

    Without `items`, as a person, it holds whatever it is asked for.
    """

    items: dict[str, int | None] | None = None


class Fixture(Device):
    """What holds the thing that is measured: an operator's hands, a robot, or the twin's scene."""

    kind = "fixture"

    @property
    @final
    def caps(self) -> FixtureCaps:
        """What it can hold; known once open."""
        self._need(State.IDLE, doing="caps")
        with self._guard("caps"):
            return self._caps()

    @final
    def mount(self, item: str, pose: int = 0) -> None:
        """Put `item` in front of the rig in its pose number `pose`, or take all away with "nothing".

        Raises `SettingError` for an item or pose that it has not.
        """
        self._need(State.IDLE, doing="mount")
        if item != "nothing":
            self._check_held("mount", item, pose)
        with self._guard("mount"):
            self._mount(item, pose)

    @final
    def pose(self, item: str, pose: int = 0) -> RigidTransform | None:
        """T_camera_item of `item` in its pose number `pose`, or None where the fixture does not know.

        Raises `SettingError` for an item or pose that it has not.
        """
        self._need(State.IDLE, doing="pose")
        self._check_held("pose", item, pose)
        with self._guard("pose"):
            return self._pose(item, pose)

    @final
    def check(self, item: str, pose: int = 0) -> None:
        """Refuse an item or pose that it has not: `SettingError`; nothing moves.

        Raises `ConfigError` for an item that it has and cannot put up.
        """
        self._need(State.IDLE, doing="check")
        if item != "nothing":
            self._check_held("check", item, pose)
            with self._guard("check"):
                self._check(item, pose)

    def _check_held(self, doing: str, item: str, pose: int) -> None:
        items = self.caps.items
        if items is not None and item not in items:
            raise SettingError(self.name, doing, f"has no item '{item}'", f"it has {sorted(items)}")
        poses = items[item] if items is not None else None
        if pose < 0 or (poses is not None and pose >= poses):
            raise SettingError(self.name, doing, f"{item} has no pose {pose}", f"it has {poses}")

    def _pose(self, item: str, pose: int) -> RigidTransform | None:
        """An operator's hands know no pose; a fixture that does overrides this."""
        return None

    def _check(self, item: str, pose: int) -> None:
        """Refuse what `caps` lists but cannot be put up."""

    @abstractmethod
    def _caps(self) -> FixtureCaps: ...

    @abstractmethod
    def _mount(self, item: str, pose: int) -> None: ...
