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
    """Follows a workflow by the methods it overrides; what one raises ends the workflow."""

    def stage(self, name: str) -> AbstractContextManager[Progress]:
        """Enter a stage of the work, and report the share of it that is done to what is entered."""
        return nullcontext(no_progress)

    def message(self, sentence: str) -> None:
        """Take a sentence for the operator, such as a warning, or why a pose was left out."""

    def plan(self, plan: Plan, size: tuple[int, int], lattice: Lattice) -> None:
        """Take what will be projected, and on which projector, its size (width, height) in px."""

    def calibration(self, calibration: Calibration) -> None:
        """Take the calibration that points are triangulated with."""

    def frame(self, frame: Frame) -> None:
        """Take a frame as it was acquired."""

    def exposed(self) -> None:
        """Take that the last exposure is over, before its frame is on disk: whatever stood still may move."""

    def maps(self, decoded: Decoded) -> None:
        """Take projector coordinates before their points are known."""

    def result(self, result: object) -> None:
        """Take a result, or a part of it such as an epoch of a search, before it is drawn and written."""
