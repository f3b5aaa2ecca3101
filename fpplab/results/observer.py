"""What follows a workflow: progress bars, the viewer, or a program of one's own."""

from __future__ import annotations

from contextlib import AbstractContextManager, nullcontext
from typing import TYPE_CHECKING

from fpplab.core.progress import Progress, no_progress

if TYPE_CHECKING:
    from fpplab.calibration.model import Calibration
    from fpplab.core.conventions import Lattice
    from fpplab.devices import Frame
    from fpplab.patterns.plan import Plan
    from fpplab.phase import Decoded


class Observer:
    """Follows a workflow. Each method may be overridden; here they do nothing.

    A class and no Protocol, so that observers override what they need and keep working when workflows report
    more. What a method raises ends the workflow.
    """

    def stage(self, name: str) -> AbstractContextManager[Progress]:
        """Enter a stage of the work, and report the share of it that is done to what is entered.

        Parameters
        ----------
        name : str
            What is done, such as `Scanning`.

        Returns
        -------
        context manager of callable
            Entered while the stage lasts.
        """
        return nullcontext(no_progress)

    def message(self, sentence: str) -> None:
        """Take a sentence for the operator.

        Parameters
        ----------
        sentence : str
            Such as a warning, or why a pose was left out.
        """

    def plan(self, plan: Plan, size: tuple[int, int], lattice: Lattice) -> None:
        """Take what will be projected, and on which projector.

        Parameters
        ----------
        plan : Plan
            The fringe sets.
        size : tuple of int
            Width and height of the projector in px.
        lattice : Lattice
            Arrangement of its pixels.
        """

    def calibration(self, calibration: Calibration) -> None:
        """Take the calibration that points are triangulated with.

        Parameters
        ----------
        calibration : Calibration
            Both devices and their pose.
        """

    def frame(self, frame: Frame) -> None:
        """Take a frame as it was acquired.

        Parameters
        ----------
        frame : Frame
            Raw levels, with the number of their image.
        """

    def maps(self, decoded: Decoded) -> None:
        """Take projector coordinates before their points are known.

        Parameters
        ----------
        decoded : Decoded
            Maps (height, width).
        """

    def result(self, result: object) -> None:
        """Take a result, or a part of it, as soon as it is known and before it is drawn and written.

        Parameters
        ----------
        result : object
            Such as a `ScanResult`, or one epoch of a search.
        """
