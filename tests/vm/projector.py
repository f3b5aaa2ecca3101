"""The emulated projector on the guest's USB, in a process of its own, and how tests inspect it.

A thread would not do: hidapi holds Python's lock while the device is asked who it is.
"""

from collections import deque
from collections.abc import Mapping
from multiprocessing.managers import BaseManager
from typing import Any

from drivers.clock import RealClock
from drivers.dlp4500.framing import READ, UsbMessage
from drivers.emulators.dlpc350 import STRICT, Dlpc350, EmulatedHid, ProjectedLight, Pulse, UsbFault
from drivers.emulators.dlpc350.usbip import UsbIpAttachment
from fpplab.core import config
from fpplab.patterns.fringes import Pattern
from tests.conformance.dlp4500 import flash, shown

ADDRESS = "/run/projector"
MOST_PULSES = 10_000


class Controller(Dlpc350):
    """Counts its commands, and reads that are repeated once: a program waits as long as the guest is slow."""

    def __init__(self, *words: Any) -> None:
        super().__init__(*words)
        self.commands = 0
        self._known_reads: set[bytes] = set()

    def answer(self, message: UsbMessage) -> UsbMessage | None:
        """Count and carry out a message."""
        self.commands += message.payload not in self._known_reads
        if message.flags & READ:
            self._known_reads.add(message.payload)
        return super().answer(message)


class Projector:
    """The controller with the conformance patterns, on USB by a cable that can be unplugged.

    Its methods are called from other processes.
    """

    def __init__(self) -> None:
        images, self._index = flash()
        self._caught: deque[ProjectedLight | None] = deque(maxlen=MOST_PULSES)
        self._controller = Controller(RealClock(), images, STRICT, self._pulsed)
        self._hid = EmulatedHid(self._controller)
        self._cable = UsbIpAttachment(self._hid)

    def start(self) -> None:
        """Attach it to USB."""
        self._cable.__enter__()

    def index(self) -> str:
        """The file that says which pattern is where in its flash."""
        return config.dump(self._index)

    def unplug(self) -> None:
        """Unplug the cable."""
        with self._cable.lock:
            self._hid.unplug()

    def plug(self) -> None:
        """Plug the cable in again."""
        with self._cable.lock:
            self._hid.plug()

    def fail(self, faults: Mapping[int, UsbFault]) -> None:
        """Let requests fail, by index from the next one on, and no others."""
        with self._cable.lock:
            self._hid.faults = {self._hid.requests + ahead: fault for ahead, fault in faults.items()}

    def commands(self) -> int:
        """Number of commands so far, repeated reads once."""
        with self._cable.lock:
            return self._controller.commands

    def lit(self) -> Pattern | None:
        """The pattern that is shown at this moment."""
        with self._cable.lock:
            return shown(self._controller.light(), self._index)

    def forget(self) -> None:
        """Forget earlier pulses."""
        with self._cable.lock:
            self._caught.clear()

    def caught(self) -> tuple[Pattern | None] | None:
        """The pattern that was shown at the next pulse on trigger output 1; None if there was none."""
        with self._cable.lock:
            return (shown(self._caught.popleft(), self._index),) if self._caught else None

    def _pulsed(self, pulse: Pulse) -> None:
        if pulse.output == 1:
            self._caught.append(self._controller.light_at(pulse.rise_s))


class Wires(BaseManager):
    """Connects the processes."""


def connected() -> Projector:
    """Control the projector of this guest from another process."""
    Wires.register("projector")
    wires = Wires(ADDRESS, authkey=b"guest")
    wires.connect()
    projector: Projector = wires.projector()  # type: ignore[attr-defined]
    return projector


def serve() -> None:
    """Run the projector's process until it is killed."""
    projector = Projector()
    projector.start()
    Wires.register("projector", callable=lambda: projector)
    Wires(ADDRESS, authkey=b"guest").get_server().serve_forever()


if __name__ == "__main__":
    serve()
