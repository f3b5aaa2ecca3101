"""Software emulator of a GRBL 1.1 controller with one motorised rail, in place of a stage.

It follows GRBL's documentation and source (github.com/gnea/grbl) in what the stage's driver relies on, and
understands the lines that the driver sends and no others. It is no evidence of how a real stage behaves.
"""

from collections.abc import Iterator
from contextlib import contextmanager

from drivers.emulators.grbl.controller import GrblController, GrblPolicy, GrblState
from drivers.emulators.grbl.drive import Rail
from drivers.emulators.terminal import PseudoTerminal

__all__ = ["GrblController", "GrblPolicy", "GrblState", "Rail", "serve_stage"]


@contextmanager
def serve_stage() -> Iterator[dict[str, str]]:
    """Run an emulated stage controller on a pseudo-terminal in real time; a context manager."""
    with PseudoTerminal(GrblController()) as terminal:
        backend = f"{{backend: grbl, port: {terminal.port}}}"
        yield {"port": terminal.port, "stage": backend}
