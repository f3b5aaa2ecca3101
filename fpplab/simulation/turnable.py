"""Simulations whose projector can be turned, which no stage of a real bench does."""

from __future__ import annotations

from typing import Protocol, runtime_checkable


@runtime_checkable
class Turnable(Protocol):
    """A simulation whose projector can be turned about the vertical axis through its centre.

    `fpplab optimise` uses it to search the angle of convergence.
    """

    def turn(self, convergence_deg: float) -> None:
        """Turn the projector towards the camera.

        Called between frames, on the open rig; the frames that follow are taken in the new arrangement.

        Parameters
        ----------
        convergence_deg : float
            Degrees from the world file's direction, positive towards the camera.
        """
        ...
