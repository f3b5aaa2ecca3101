"""The controller's boot loader, which erases and writes the flash and computes checksums.

The boot loader is a program of its own. The projector disappears from USB when it enters or leaves the boot
loader, and reappears running the other program. The boot loader cannot read the flash, but the checksum of a
single byte is that byte.

Source: TI's DLPC350 client and GUI. Tested on an emulated flash only, not yet on a board.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from drivers.clock import Clock, Polling
from drivers.dlp4500.flash import memory
from drivers.dlp4500.layout import Command, RawBytes, RegisterField, RegisterLayout
from drivers.dlp4500.protocol import VERSION
from drivers.dlp4500.transport import Link
from fpplab.core.errors import (
    DeviceError,
    DeviceTimeoutError,
    DisconnectedError,
    ProtocolError,
    SettingError,
    StateError,
)

_NUMBER = RegisterLayout((RegisterField("value", 32),))
MAX_DATA_BYTES = 504
"""Bytes of one data message, as TI's client sends them: two less than fit, or the boot loader fails."""

ENTER = Command("enter the boot loader", 0x3001, RegisterLayout(), acknowledged=False)
READ_STATUS = Command(
    "boot loader's answer",
    0x0015,
    returned=RawBytes(10, 60),
    selector=RegisterLayout((RegisterField("what", 8, (0x00, 0x0C, 0x0D)),)),
)
FLASH_TYPE = Command("flash type", 0x002F, RegisterLayout((RegisterField("algorithm", 8),)))
ADDRESS = Command("flash address", 0x0029, _NUMBER)
ERASE = Command("erase sector", 0x0028, RegisterLayout())
UPLOAD_SIZE = Command("upload size", 0x002C, _NUMBER)
DATA = Command("flash data", 0x0025, RawBytes(1, MAX_DATA_BYTES), acknowledged=False)
SUM = Command("start checksum", 0x0026, RegisterLayout(), acknowledged=False)
LEAVE = Command(
    "leave the boot loader", 0x0030, RegisterLayout((RegisterField("how", 8, (2,)),)), acknowledged=False
)

_CHECKSUM, _MANUFACTURER, _DEVICE = 0x00, 0x0C, 0x0D
"""What `READ_STATUS` may be asked for; byte 0 of each answer is the boot loader's status."""
EVM_FLASH = 0x0020, 0x227E  # manufacturer and device id of the flash on the evaluation module

FLASH_BUSY = Polling(step_s=0.01, limit_s=30.0)  # for one sector (chosen; TI's sources give no figure)
IDENTITY = Polling(step_s=0.05, limit_s=1.0)  # of the flash: zeros are not believed at once (chosen)
RESTART = Polling(step_s=0.25, limit_s=15.0)  # until the device reappears on USB; TI's SDK waits 10 s

Connect = Callable[[], Link]  # opens a link to the projector, whichever program it runs


class BootLoaderLink:
    """A link to the boot loader; offsets count from the first byte of the flash.

    Every method may raise the errors of `Link.write` and `Link.read`, and `DeviceTimeoutError` where the
    flash stays busy.
    """

    def __init__(self, link: Link, clock: Clock, name: str) -> None:
        self.link, self._clock, self.name = link, clock, name

    def identify(self) -> None:
        """Check the type of the flash and select the algorithm that writes it."""
        self._wait("identify")  # an interrupted upload may have left it busy
        for _ in range(round(IDENTITY.limit_s / IDENTITY.step_s)):
            identity = self._read_number(_MANUFACTURER), self._read_number(_DEVICE)
            if all(identity):
                break
            self._clock.sleep(IDENTITY.step_s)
        if identity != EVM_FLASH:
            raise DeviceError(
                self.name,
                "identify",
                f"the flash is {_described(identity)}, not {_described(EVM_FLASH)}",
                "only the evaluation module's flash can be written",
            )
        self.link.write(FLASH_TYPE, algorithm=0)  # that of the evaluation module's flash

    def erase(self, sector: int) -> None:
        self._check(sector * memory.SECTOR, memory.SECTOR)
        self.link.write(ADDRESS, value=sector * memory.SECTOR)
        self.link.write(ERASE)
        self._wait("erase sector")  # TI's firmware update does not wait here, its image upload does

    def write(self, offset: int, data: bytes) -> None:
        """Write to erased flash and compare checksums."""
        self._check(offset, len(data))
        self.link.write(ADDRESS, value=offset)
        self.link.write(UPLOAD_SIZE, value=len(data))
        for start in range(0, len(data), MAX_DATA_BYTES):
            self.link.write_bytes(DATA, data[start : start + MAX_DATA_BYTES])
        self._wait("flash data")
        checksum, expected = self.checksum(offset, len(data)), memory.flash_checksum(data)
        if checksum != expected:
            raise DeviceError(
                self.name,
                "flash data",
                f"the checksum of {len(data)} bytes at {offset:#x} is {checksum:#x}, not {expected:#x}",
                "give the same command again; it continues from there",
            )

    def checksum(self, offset: int, size: int) -> int:
        self.link.write(ADDRESS, value=offset)
        self.link.write(UPLOAD_SIZE, value=size)
        self.link.write(SUM)
        self._wait("start checksum")
        return self._read_number(_CHECKSUM)

    def read(self, offset: int, size: int) -> bytes:
        return bytes(self.checksum(at, 1) & 0xFF for at in range(offset, offset + size))

    def leave(self) -> None:
        """Start the projector's program and close the link."""
        try:
            self.link.write(LEAVE, how=2)
        finally:
            self.link.close()

    def _check(self, offset: int, size: int) -> None:
        # Sector 0 is the boot loader's: without it a projector cannot be repaired over USB.
        if offset < memory.SECTOR or offset + size > memory.SIZE:
            raise SettingError(
                self.name,
                "write flash",
                f"{size} bytes at {offset:#x} are in the boot sector or beyond the flash",
                f"{memory.SECTOR:#x} to {memory.SIZE:#x} can be written",
            )

    def _read_number(self, query: int) -> int:
        # The value is in bytes 6 to 9; the device id continues in bytes 12 to 15.
        answer = self.link.read_bytes(READ_STATUS, what=query)
        low, high = answer[6:10], answer[12:16] if query == _DEVICE else b""
        return int.from_bytes(low + high, "little")

    def _wait(self, operation: str) -> None:
        deadline = self._clock.now() + FLASH_BUSY.limit_s
        while self.link.read_bytes(READ_STATUS, what=_CHECKSUM)[0] & 0x08:  # bit 3: busy
            if self._clock.now() > deadline:
                raise DeviceTimeoutError(
                    self.name,
                    operation,
                    f"the flash is still busy after {FLASH_BUSY.limit_s:g} s",
                    "switch the projector off and on, and give the same command again",
                )
            self._clock.sleep(FLASH_BUSY.step_s)


def _described(part: tuple[int, int]) -> str:
    return "maker {:#06x} part {:#06x}".format(*part)


@contextmanager
def boot_loader_session(connect: Connect, clock: Clock, name: str) -> Iterator[BootLoaderLink]:
    """Enter the boot loader, and restart the projector's program at the end of the context."""
    # It does not matter whether the projector runs its boot loader already.
    loader = BootLoaderLink(_enter_boot_loader(connect, clock, name), clock, name)
    try:
        loader.identify()
        yield loader
    except BaseException:
        with suppress(DeviceError):  # the original failure is the one to report
            loader.leave()
        raise
    loader.leave()
    _reopen_after_restart(connect, clock, name, into_program=True).close()


def _enter_boot_loader(connect: Connect, clock: Clock, name: str) -> Link:
    link = connect()
    if not _runs_program(link):
        return link
    try:
        link.write(ENTER)
    finally:
        link.close()
    return _reopen_after_restart(connect, clock, name, into_program=False)


def _runs_program(link: Link) -> bool:
    """Tell whether the projector reports its version, a command that the boot loader does not have."""
    try:
        link.read(VERSION)
    except (ProtocolError, DeviceTimeoutError):
        return False
    return True


def _reopen_after_restart(connect: Connect, clock: Clock, name: str, into_program: bool) -> Link:
    """Open the projector again once it has reappeared running the other program."""
    deadline, is_last = clock.now() + RESTART.limit_s, False
    while not is_last:
        clock.sleep(RESTART.step_s)
        is_last = clock.now() >= deadline  # tried after it, too: a busy computer may sleep for longer
        try:
            link = connect()
        except DeviceError:  # not reappeared yet, or not ready yet
            continue
        with suppress(DisconnectedError):  # it was about to restart
            if _runs_program(link) == into_program:
                return link
        link.close()
    raise StateError(
        name,
        "restart",
        f"does not reappear {'from' if into_program else 'in'} its boot loader within {RESTART.limit_s:g} s",
        "switch the projector off and on, and give the same command again",
    )
