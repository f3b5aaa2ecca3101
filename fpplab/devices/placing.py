"""Fixtures that can be asked for a pose: by a transform, as a robot can, or in words, as a person can.

A fixture that is neither mounts its items in poses that it has by number, and no others.
"""

from __future__ import annotations

from abc import abstractmethod
from pathlib import Path
from typing import final

from fpplab.core.geometry import RigidTransform
from fpplab.devices.device import State
from fpplab.devices.fixture import Fixture


class PosableFixture(Fixture):
    """A fixture that puts an item where it is told: a robot, or a simulation."""

    @final
    def place(self, item: str, T_camera_item: RigidTransform) -> None:
        """Put an item into a pose."""
        self._need(State.IDLE, doing="place")
        self._check_held("place", item, 0)
        with self._guard("place"):
            self._place(item, T_camera_item)

    @abstractmethod
    def _place(self, item: str, T_camera_item: RigidTransform) -> None:
        """Put the item into that pose, and return once it is at rest there.

        Called by `place` in IDLE with an item of `_caps`. The pose may be a little wrong, since camera and
        fixture are not calibrated to each other well while the camera is being calibrated. Raise
        `SettingError` for a pose out of reach; nothing moves then.
        """


class InstructableFixture(Fixture):
    """A fixture that puts an item where it is asked to in words: a person."""

    @final
    def instruct(self, item: str, words: str, picture: Path | None = None) -> None:
        """Ask for an item in a pose."""
        self._need(State.IDLE, doing="instruct")
        self._check_held("instruct", item, 0)
        with self._guard("instruct"):
            self._instruct(item, words, picture)

    @abstractmethod
    def _instruct(self, item: str, words: str, picture: Path | None) -> None:
        """Ask for the item in that pose, and return once it is at rest there, as well as a hand can.

        Called by `instruct` in IDLE with an item of `_caps`.
        """
