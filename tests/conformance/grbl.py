"""The reference bench, with a GRBL controller on a pseudo-terminal in place of its stage."""

import time

from drivers.emulators.grbl import GrblController
from drivers.emulators.terminal import PseudoTerminal
from tests.conformance.reference import ReferenceBench

TIMES_FASTER = 100.0


class GrblBench(ReferenceBench):
    """Brings the stage its port."""

    def open(self) -> None:
        super().open()
        self._terminal = PseudoTerminal(GrblController(lambda: TIMES_FASTER * time.monotonic()))
        self.stage_port = self._terminal.__enter__().port

    def close(self) -> None:
        super().close()
        self._terminal.__exit__(None, None, None)
