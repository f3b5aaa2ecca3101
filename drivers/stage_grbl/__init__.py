"""A linear stage behind a GRBL 1.1 controller, over a serial port.

lines: what the controller says; wire: sending, and which answer belongs to it; device: the stage itself.
"""

from __future__ import annotations

from drivers.stage_grbl.device import GrblStage

__all__ = ["GrblStage"]
