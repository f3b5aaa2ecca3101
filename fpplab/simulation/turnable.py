"""Simulations whose projector can be turned, which no stage of a bench does."""

from __future__ import annotations

from typing import Protocol, runtime_checkable


@runtime_checkable
class Turnable(Protocol):
    """A simulation whose projector can be turned about the vertical through its centre."""

    def turn(self, convergence_deg: float) -> None:
        """Turn the projector towards the camera.

        Called between frames, on the open rig.

        Parameters
        ----------
        convergence_deg : float
            Degrees from how the world file has it, positive towards the camera.
        """
        ...
