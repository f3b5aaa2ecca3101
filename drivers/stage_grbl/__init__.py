"""Driver of a linear stage behind a GRBL 1.1 controller on a serial port.

`lines` parses the controller's messages, `wire` sends commands and matches their answers, `device` is the
stage itself.
"""

from drivers.stage_grbl.device import GrblStage

__all__ = ["GrblStage"]
