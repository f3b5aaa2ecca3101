"""An emulated projector with a flash that can be rewritten, and whose power can fail at any message."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.clock import Clock, SteppedClock
from drivers.dlp4500.flash.firmware import Firmware
from drivers.dlp4500.flash.loader import boot_loader_session
from drivers.dlp4500.flash.upload import perform_upload, plan_upload, verify_image_count
from drivers.dlp4500.framing import UsbMessage
from drivers.dlp4500.transport import Link, connect
from drivers.emulators.dlpc350 import Dlpc350Policy, EmulatedHid, FlashedDlpc350

ENTER, ERASE, DATA, LEAVE = 0x3001, 0x0028, 0x0025, 0x0030
ADDRESS = 0x0029
SECTOR = 0x20000


class FailingBoard(FlashedDlpc350):
    """Loses power in the middle of message number `fails_at`, of which half the data are taken.

    messages: the commands so far. erased: the sectors.
    """

    hid: EmulatedHid

    def __init__(self, clock: Clock, content: bytes, policy: Dlpc350Policy | None) -> None:
        self.fails_at: int | None = None
        self.messages: list[int] = []
        self.erased: list[int] = []
        self._address = 0
        super().__init__(clock, content, policy)

    def answer(self, message: UsbMessage) -> UsbMessage | None:
        number, data = int.from_bytes(message.payload[:2], "little"), message.payload[2:]
        self.messages.append(number)
        if number == ADDRESS:
            self._address = int.from_bytes(data, "little")
        if number == ERASE:
            self.erased.append(self._address // SECTOR)
        if len(self.messages) - 1 != self.fails_at:
            return super().answer(message)
        half = message.payload[: 2 + len(data) // 2] if number == DATA else message.payload
        super().answer(UsbMessage(message.flags, message.sequence, half))
        self.lose_power()
        self.hid.leave_bus(self.policy.reset_s)
        return None


class Bench:
    """The board and its USB connection."""

    def __init__(
        self, content: bytes, policy: Dlpc350Policy | None = None, clock: Clock | None = None
    ) -> None:
        self.clock = clock or SteppedClock()
        self.board = FailingBoard(self.clock, content, policy)
        self.hid = self.board.hid = EmulatedHid(self.board)
        self.board.on_restart = self.hid.leave_bus

    def link(self) -> Link:
        """Open it, whether it runs the application or the boot loader."""
        return Link(connect(self.hid, "projector", None)[0], self.clock, "projector")

    def upload(self, firmware: Firmware) -> list[str]:
        """As the command does it; the words for the operator."""
        with boot_loader_session(self.link, self.clock, "projector") as loader:
            work = plan_upload(firmware, loader)
            perform_upload(firmware, loader, work, lambda share: None)
        verify_image_count(firmware, self.link())
        return work.summary

    def flash(self) -> NDArray[np.uint8]:
        """Return the present content of the flash."""
        return np.frombuffer(self.board.flash.content, np.uint8).copy()

    def runs_program(self) -> bool:
        """Whether it would start its application now, and not only the boot loader."""
        return self.board.loader is None


def firmware(content: bytes) -> Firmware:
    """Make a firmware file as it is read."""
    return Firmware(content, Path("patterns.bin"))
