"""Fixtures that accept a pose: as a transform, as a robot does, or in words, as a person does."""

from abc import abstractmethod
from pathlib import Path
from typing import final

from fpplab.core.geometry import RigidTransform
from fpplab.devices.device import State
from fpplab.devices.fixture import Fixture


class PosableFixture(Fixture):
    """A fixture that puts an item into any pose within its reach: a robot, or a simulation."""

    @final
    def place(self, item: str, T_camera_item: RigidTransform) -> None:
        """Put an item into a pose.

        Parameters
        ----------
        item : str
            What the fixture calls it.
        T_camera_item : RigidTransform
            The pose in the camera's frame, in mm.

        Raises
        ------
        SettingError
            The fixture has no such item, or the pose is out of reach.
        """
        self._need(State.IDLE, doing="place")
        self._check_held("place", item, 0)
        with self._guard("place"):
            self._place(item, T_camera_item)

    @abstractmethod
    def _place(self, item: str, T_camera_item: RigidTransform) -> None:
        """Put an item into a pose, and return once it is at rest there; called by `place` in IDLE.

        Parameters
        ----------
        item : str
            One of those in `_caps`.
        T_camera_item : RigidTransform
            The pose in the camera's frame, in mm. It may be a little wrong, since camera and fixture are not
            calibrated to each other well while the camera is being calibrated.

        Raises
        ------
        SettingError
            The pose is out of reach; nothing has moved.
        """


class InstructableFixture(Fixture):
    """A fixture that follows a description of the pose in words: a person."""

    @final
    def instruct(self, item: str, description: str, picture: Path | None = None) -> None:
        """Ask for an item in a pose.

        Parameters
        ----------
        item : str
            What the fixture calls it.
        description : str
            The pose in words, such as "tilted to the left".
        picture : path, optional
            An image file that shows it.

        Raises
        ------
        SettingError
            The fixture has no such item.
        """
        self._need(State.IDLE, doing="instruct")
        self._check_held("instruct", item, 0)
        with self._guard("instruct"):
            self._instruct(item, description, picture)

    @abstractmethod
    def _instruct(self, item: str, description: str, picture: Path | None) -> None:
        """Ask for an item in a pose, and return once it is at rest there; called by `instruct` in IDLE.

        Parameters
        ----------
        item : str
            One of those in `_caps`.
        description : str
            The pose in words.
        picture : path or None
            An image file that shows it.

        Raises
        ------
        DeviceError
            Nobody is there to do it.
        """
