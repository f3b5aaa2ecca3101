"""A GRBL 1.1 controller with one motorised rail behind it, to stand in for a stage.

It follows GRBL's interface documentation and source (github.com/gnea/grbl): one answer to each line,
real-time commands, reports, settings, homing, limits, alarms and resets. Motion takes its time, by a clock
that may be anyone's. Each move ends at rest, where GRBL would blend moves that follow each other. Left out:
arcs, probing, spindle and coolant, overrides, check mode, sleep and the safety door.

What a stage really does is not proven by it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from drivers.emulators.grbl.controller import GrblController, GrblPolicy, GrblState
from drivers.emulators.grbl.drive import Rail
from drivers.emulators.terminal import PseudoTerminal

__all__ = ["GrblController", "GrblPolicy", "GrblState", "Rail", "serve_stage"]


@contextmanager
def serve_stage() -> Iterator[dict[str, str]]:
    """A controller on a pseudo-terminal in real time; gives its port, and the stage of a rig file for it."""
    with PseudoTerminal(GrblController()) as terminal:
        backend = f'{{backend: "drivers.stage_grbl:GrblStage", port: {terminal.port}}}'
        yield {"port": terminal.port, "stage": backend}
