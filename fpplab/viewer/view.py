"""What every kind of view has in common."""

from __future__ import annotations

from fpplab.viewer.canvas import Canvas


class CommandView:
    """What one command shows; its methods draw on the canvas."""

    def __init__(self, canvas: Canvas) -> None:
        self.canvas = canvas
        self.begin()

    def begin(self) -> None:
        """Arrange the views and draw what is there from the beginning."""
        raise NotImplementedError
