"""The boot loader of the emulated projector, and a projector that starts from its flash.

The loader's commands are defined here independently of the driver, so that each verifies the other.
"""

import struct
from collections.abc import Callable
from typing import NoReturn

from drivers.clock import Clock
from drivers.dlp4500.framing import ERROR, READ, REPLY_WANTED, UsbMessage
from drivers.emulators.dlpc350.engine import Dlpc350Policy
from drivers.emulators.dlpc350.firmware import CommandRejected, Dlpc350
from drivers.emulators.dlpc350.flash import SECTOR, Flash, stored_images
from drivers.emulators.dlpc350.sequencer import Pulse

ENTER = 0x3001  # number of the command by which the application enters the boot loader (TI's client)
_READ_STATUS, _EXIT = 0x0015, 0x0030
_MANUFACTURER, _PART = 0x0020, 0x227E  # identity of the evaluation module's flash
_BUSY = 0x08  # bit of the status (TI's client)


class BootLoader:
    """The program by which the flash is written."""

    def __init__(self, flash: Flash, clock: Clock, policy: Dlpc350Policy) -> None:
        self._flash, self._clock, self._policy = flash, clock, policy
        self._address = self._size = self._written = self._checksum = 0
        self._busy_until_s, self._blanks = 0.0, policy.blank_identities
        self._erasing: int | None = None
        self.exit_requested = False

    def answer(self, message: UsbMessage) -> UsbMessage | None:
        number, data = int.from_bytes(message.payload[:2], "little"), message.payload[2:]
        flags, data_out = message.flags, b""
        try:
            if message.flags & READ:
                data_out = self._read_status(number, data)
            else:
                self._execute(number, data)
        except CommandRejected:
            flags |= ERROR
        if not message.flags & REPLY_WANTED:
            return None
        if not message.flags & READ and self._policy.acknowledges_with_command:
            data_out = message.payload[:2]
        return UsbMessage(flags, message.sequence if self._policy.echoes_sequence else 0, data_out)

    def lose_power(self) -> None:
        """Stop immediately; a sector that is being erased stays half erased."""
        if self._erasing is not None and self._is_busy():
            self._flash.erase_partially(self._erasing)

    def _is_busy(self) -> bool:
        return self._clock.now() < self._busy_until_s

    def _read_status(self, number: int, data: bytes) -> bytes:
        values = {0x00: self._checksum, 0x0C: _MANUFACTURER, 0x0D: _PART}
        if number != _READ_STATUS or len(data) != 1 or data[0] not in values:
            raise CommandRejected
        if data[0] != 0x00 and self._blanks:
            self._blanks -= 1
            values[data[0]] = 0
        status = _BUSY if self._is_busy() else 0
        return bytes([status, 0, 0, 0, 0, 0]) + values[data[0]].to_bytes(4, "little") + bytes(6)

    def _execute(self, number: int, data: bytes) -> None:
        if self._is_busy():
            raise CommandRejected
        handlers: dict[int, Callable[[bytes], None]] = {
            0x0029: self._set_address,
            0x0028: self._erase,
            0x002C: self._set_size,
            0x0025: self._write_data,
            0x0026: self._compute_checksum,
            0x002F: self._set_type,
            _EXIT: self._exit,
        }
        handlers.get(number, self._refuse)(data)

    def _refuse(self, data: bytes) -> NoReturn:
        raise CommandRejected

    def _set_address(self, data: bytes) -> None:
        self._address, self._written = _number(data), 0

    def _set_size(self, data: bytes) -> None:
        self._size, self._written = _number(data), 0

    def _set_type(self, data: bytes) -> None:
        if data != b"\0":
            raise CommandRejected

    def _erase(self, data: bytes) -> None:
        if data or self._address % SECTOR:
            raise CommandRejected
        self._check_protection()
        self._erasing = self._address // SECTOR
        self._flash.erase(self._erasing)
        self._busy_until_s = self._clock.now() + self._policy.sector_erase_s

    def _write_data(self, data: bytes) -> None:
        if self._written + len(data) > self._size or len(data) > self._policy.max_loader_data:
            raise CommandRejected
        self._check_protection()
        self._flash.write(self._address + self._written, data)
        self._written += len(data)

    def _check_protection(self) -> None:
        if self._address < SECTOR and self._policy.protects_boot_sector:
            raise CommandRejected

    def _compute_checksum(self, data: bytes) -> None:
        self._checksum = self._flash.checksum(self._address, self._size)
        self._erasing = None
        self._busy_until_s = self._clock.now() + self._policy.checksum_s

    def _exit(self, data: bytes) -> None:
        if data != b"\2":
            raise CommandRejected
        self.exit_requested = True


def _number(data: bytes) -> int:
    if len(data) != 4:
        raise CommandRejected
    return int.from_bytes(data, "little")


class FlashedDlpc350(Dlpc350):
    """A projector with a flash that can be rewritten: it shows the images stored there.

    It starts its application only if program and configuration in flash are those that it was made with and
    the flash table leads to them; otherwise only the boot loader.
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
        self._program = self.flash.read_listed_firmware_blocks()
        self.switch_on()

    def switch_on(self) -> None:
        """Start the application, or the boot loader if there is no valid application."""
        runs = self._program is not None and self.flash.read_listed_firmware_blocks() == self._program
        self.loader = None if runs else BootLoader(self.flash, self.clock, self.policy)
        if runs:
            try:
                self.images = [image.planes for image in stored_images(self.flash.content)]
            except (ValueError, IndexError, struct.error):  # no images, or invalid ones
                self.images = []
            self.load_s = [self.policy.image_load_s] * len(self.images)
            self.restart()

    def lose_power(self) -> None:
        """Cut the power during whatever is under way, and switch on again."""
        if self.loader is not None:
            self.loader.lose_power()
        self.switch_on()

    def answer(self, message: UsbMessage) -> UsbMessage | None:
        """Carry out a message, as the application or as the boot loader."""
        if self.loader is None:
            if self.frozen or int.from_bytes(message.payload[:2], "little") != ENTER:
                return super().answer(message)
            self.loader = BootLoader(self.flash, self.clock, self.policy)
            self.on_restart(self.policy.reset_s)
            return None
        reply = self.loader.answer(message)
        if self.loader.exit_requested:
            self.switch_on()
            self.on_restart(self.policy.reset_s)
        return reply
