"""Driver of a linear stage behind a GRBL 1.1 controller on a serial port."""

from drivers.stage_grbl.device import GrblStage

__all__ = ["GrblStage"]
