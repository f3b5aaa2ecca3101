"""Fixtures; some accept a pose: as a transform, as a robot does, or in words, as a person does."""

from abc import abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import final

from fpplab.core.errors import SettingError
from fpplab.core.geometry import RigidTransform
from fpplab.devices.device import Device, State


@dataclass(frozen=True)
class FixtureCaps:
    """What a fixture can hold."""

    # In how many poses each item (None: as many as wanted); None where any can be held, as an operator can
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
            return self._of_kind(FixtureCaps, self._caps(), "_caps")

    @final
    def mount(self, item: str, pose: int = 0) -> None:
        """Put an item in front of the rig.

        Parameters
        ----------
        item : str
            What the fixture calls it; `nothing` takes all away.
        pose : int
            In which of its poses, from 0.

        Raises
        ------
        SettingError
            The fixture has no such item or pose.
        """
        self._need(State.IDLE, doing="mount")
        if item != "nothing":
            self._check_held("mount", item, pose)
        with self._guard("mount"):
            self._mount(item, pose)

    @final
    def pose(self, item: str, pose: int = 0) -> RigidTransform | None:
        """Tell where an item is held.

        Parameters
        ----------
        item : str
            What the fixture calls it.
        pose : int
            In which of its poses, from 0.

        Returns
        -------
        RigidTransform or None
            T_camera_item in mm; None where the fixture does not know.

        Raises
        ------
        SettingError
            The fixture has no such item or pose.
        """
        self._need(State.IDLE, doing="pose")
        self._check_held("pose", item, pose)
        with self._guard("pose"):
            return self._pose(item, pose)

    @final
    def check(self, item: str, pose: int = 0) -> None:
        """Refuse an item or pose that cannot be mounted; nothing moves.

        Parameters
        ----------
        item : str
            What the fixture calls it, or `nothing`.
        pose : int
            In which of its poses, from 0.

        Raises
        ------
        SettingError
            The fixture has no such item or pose.
        ConfigError
            It has the item and cannot put it up.
        """
        self._need(State.IDLE, doing="check")
        if item != "nothing":
            self._check_held("check", item, pose)
            with self._guard("check"):
                self._check(item, pose)

    def _check_held(self, doing: str, item: str, pose: int) -> None:
        items = self.caps.items
        if items is not None and item not in items:
            names = ", ".join(sorted(items)) or "none"
            raise SettingError(
                self.name, doing, f"has no item '{item}'", f"name one that it has ({names}), or add it there"
            )
        poses = items[item] if items is not None else None
        if pose < 0 or (poses is not None and pose >= poses):
            raise SettingError(self.name, doing, f"{item} has no pose {pose}", f"it has {poses}")

    def _pose(self, item: str, pose: int) -> RigidTransform | None:
        """Tell where an item is held; called by `pose` in IDLE. Override it where that is known.

        Nothing moves.

        Parameters
        ----------
        item : str
            One of those in `_caps`.
        pose : int
            In which of its poses, from 0.

        Returns
        -------
        RigidTransform or None
            T_camera_item in mm; None where it is not known.
        """
        return None

    def _check(self, item: str, pose: int) -> None:
        """Refuse what `_caps` lists but cannot be mounted; called by `check` in IDLE.

        Nothing moves. Override it where an item may be missing.

        Parameters
        ----------
        item : str
            One of those in `_caps`.
        pose : int
            In which of its poses, from 0.

        Raises
        ------
        ConfigError
            It cannot be mounted, for instance because its file is missing.
        """

    @abstractmethod
    def _caps(self) -> FixtureCaps:
        """Tell what can be held; called by `caps` in IDLE and before every mounting.

        Returns
        -------
        FixtureCaps
            Items, and the number of poses of each.
        """

    @abstractmethod
    def _mount(self, item: str, pose: int) -> None:
        """Put an item in front of the rig in one of its poses, and return once it is at rest there.

        Called by `mount` in IDLE. The same item and pose may be asked for again.

        Parameters
        ----------
        item : str
            One of those in `_caps`, or `nothing`, which takes all away.
        pose : int
            In which of its poses, from 0.

        Raises
        ------
        DeviceError
            It is not there.
        """


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
