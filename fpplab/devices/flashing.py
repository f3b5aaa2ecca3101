"""Projectors that can show a pattern for some refreshes, so that a camera can measure how long one is."""

from abc import abstractmethod
from typing import final

from fpplab.core.errors import SettingError
from fpplab.devices.device import State
from fpplab.devices.projector import Projector

MAX_REFRESHES = 600  # longest flash in refreshes of the display: 10 s at 60 Hz (chosen)


class FlashingProjector(Projector):
    """A projector that shows a display, refreshed at a rate of its own."""

    @property
    @final
    def refresh_s(self) -> float:
        """Period of the refreshes in s, as the display reports it; known once open."""
        self._need(State.IDLE, State.ARMED, doing="refresh_s")
        with self._guard("refresh_s"):
            return self._refresh_period_s()

    @final
    def flash(self, i: int, refreshes: int) -> None:
        """Show one loaded pattern for some refreshes, with darkness before and after; return when dark.

        Parameters
        ----------
        i : int
            Its index among those loaded.
        refreshes : int
            How many, 1 to `MAX_REFRESHES`.

        Raises
        ------
        SettingError
            No such pattern is loaded, or `refreshes` is out of range.
        """
        self._need(State.IDLE, doing="flash")
        if not 0 <= i < len(self._loaded):
            raise SettingError(
                self.name, "flash", f"pattern {i} was asked for", f"{len(self._loaded)} are loaded"
            )
        if not 1 <= refreshes <= MAX_REFRESHES:
            raise SettingError(self.name, "flash", f"refreshes is {refreshes}", f"1 to {MAX_REFRESHES}")
        with self._guard("flash"):
            self._flash(i, refreshes)

    @abstractmethod
    def _refresh_period_s(self) -> float:
        """Tell the period of the refreshes; called by `refresh_s` in IDLE and ARMED, often: it must be quick.

        Returns
        -------
        float
            The period in s.
        """

    @abstractmethod
    def _flash(self, i: int, refreshes: int) -> None:
        """Show one loaded pattern, dark before and after; called by `flash` in IDLE.

        Parameters
        ----------
        i : int
            Its index among the loaded patterns, from 0.
        refreshes : int
            For how many refreshes, 1 to `MAX_REFRESHES`.

        Raises
        ------
        DeviceError
            It was not shown for exactly that many refreshes.
        """
