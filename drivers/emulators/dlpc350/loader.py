"""The boot loader of the emulated projector, and the projector that starts with it.

Its commands are written down a second time here, and not taken from the driver: each proves the other.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import NoReturn

from drivers.clock import Clock
from drivers.dlp4500.framing import ERROR, READ, REPLY_WANTED, UsbMessage
from drivers.emulators.dlpc350.firmware import CommandRejected, Dlpc350
from drivers.emulators.dlpc350.flash import SECTOR, Flash, stored_images
from drivers.emulators.dlpc350.policy import Dlpc350Policy
from drivers.emulators.dlpc350.sequencer import Pulse

ENTER = 0x3001
_TELL, _LEAVE = 0x0015, 0x0030
_MANUFACTURER, _PART = 0x0020, 0x227E
_BUSY = 0x08


class BootLoader:
    """What the projector runs while its flash is written. left: it was told to start the projector again."""

    def __init__(self, flash: Flash, clock: Clock, policy: Dlpc350Policy) -> None:
        self._flash, self._clock, self._policy = flash, clock, policy
        self._address = self._size = self._taken = self._sum = 0
        self._busy_until_s = 0.0
        self._erasing: int | None = None
        self.left = False

    def answer(self, message: UsbMessage) -> UsbMessage | None:
        """Do what a message asks; the reply, if it is to have one."""
        number, data = int.from_bytes(message.payload[:2], "little"), message.payload[2:]
        flags, told = message.flags, b""
        try:
            if message.flags & READ:
                told = self._tell(number, data)
            else:
                self._do(number, data)
        except CommandRejected:
            flags |= ERROR
        if not message.flags & REPLY_WANTED:
            return None
        return UsbMessage(flags, message.sequence if self._policy.echoes_sequence else 0, told)

    def lose_power(self) -> None:
        """Stop at once, with whatever is half done."""
        if self._erasing is not None and self._is_busy():
            self._flash.half_erase(self._erasing)

    def _is_busy(self) -> bool:
        return self._clock.now() < self._busy_until_s

    def _tell(self, number: int, data: bytes) -> bytes:
        values = {0x00: self._sum, 0x0C: _MANUFACTURER, 0x0D: _PART}
        if number != _TELL or len(data) != 1 or data[0] not in values:
            raise CommandRejected
        status = _BUSY if self._is_busy() else 0
        return bytes([status, 0, 0, 0, 0, 0]) + values[data[0]].to_bytes(4, "little") + bytes(6)

    def _do(self, number: int, data: bytes) -> None:
        if self._is_busy():
            raise CommandRejected
        doers: dict[int, Callable[[bytes], None]] = {
            0x0029: self._set_address,
            0x0028: self._erase,
            0x002C: self._set_size,
            0x0025: self._take,
            0x0026: self._add_up,
            0x002F: self._set_type,
            _LEAVE: self._leave,
        }
        doers.get(number, self._refuse)(data)

    def _refuse(self, data: bytes) -> NoReturn:
        raise CommandRejected

    def _set_address(self, data: bytes) -> None:
        self._address, self._taken = _number(data), 0

    def _set_size(self, data: bytes) -> None:
        self._size, self._taken = _number(data), 0

    def _set_type(self, data: bytes) -> None:
        if data != b"\0":
            raise CommandRejected

    def _erase(self, data: bytes) -> None:
        if data or self._address % SECTOR:
            raise CommandRejected
        self._guard()
        self._erasing = self._address // SECTOR
        self._flash.erase(self._erasing)
        self._busy_until_s = self._clock.now() + self._policy.sector_erase_s

    def _take(self, data: bytes) -> None:
        if self._taken + len(data) > self._size or len(data) > self._policy.most_loader_data:
            raise CommandRejected
        self._guard()
        self._flash.write(self._address + self._taken, data)
        self._taken += len(data)

    def _guard(self) -> None:
        if self._address < SECTOR and self._policy.protects_boot_sector:
            raise CommandRejected

    def _add_up(self, data: bytes) -> None:
        self._sum = self._flash.checksum(self._address, self._size)
        self._erasing = None
        self._busy_until_s = self._clock.now() + self._policy.checksum_s

    def _leave(self, data: bytes) -> None:
        if data != b"\2":
            raise CommandRejected
        self.left = True


def _number(data: bytes) -> int:
    if len(data) != 4:
        raise CommandRejected
    return int.from_bytes(data, "little")


class FlashedDlpc350(Dlpc350):
    """A projector with its flash: it shows the images that are stored there, and can be written anew.

    content: of the flash, from its first byte on. on_restart: told how long the USB device stays away. It
    starts its program as long as that is what it was made with and the table leads to it; otherwise only
    the boot loader. loader: while that runs.
    """

    def __init__(
        self,
        clock: Clock,
        content: bytes,
        policy: Dlpc350Policy | None = None,
        on_pulse: Callable[[Pulse], None] = lambda pulse: None,
    ) -> None:
        super().__init__(clock, [], policy, on_pulse)
        self.flash = Flash(content)
        self._program = self.flash.program()
        self.switch_on()

    def switch_on(self) -> None:
        """Start the program, or the boot loader where there is none."""
        runs = self._program is not None and self.flash.program() == self._program
        self.loader = None if runs else BootLoader(self.flash, self.clock, self.policy)
        if runs:
            try:
                self.images = [image.planes for image in stored_images(self.flash.content)]
            except (ValueError, IndexError, struct.error):  # no images, or broken ones
                self.images = []
            self.load_s = [self.policy.image_load_s] * len(self.images)
            self.restart()

    def lose_power(self) -> None:
        """Be cut off from power, with whatever is half done, and be switched on again."""
        if self.loader is not None:
            self.loader.lose_power()
        self.switch_on()

    def answer(self, message: UsbMessage) -> UsbMessage | None:
        """Do what a message asks, as the program or as the boot loader; the reply, if it is to have one."""
        if self.loader is None:
            if int.from_bytes(message.payload[:2], "little") != ENTER:
                return super().answer(message)
            self.loader = BootLoader(self.flash, self.clock, self.policy)
            self.on_restart(self.policy.reset_s)
            return None
        reply = self.loader.answer(message)
        if self.loader.left:
            self.switch_on()
            self.on_restart(self.policy.reset_s)
        return reply
