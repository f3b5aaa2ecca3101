"""A client that sends raw bytes to the emulated controller."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from drivers.clock import SteppedClock
from drivers.dlp4500.sequence import SIZE
from drivers.emulators.dlpc350 import Dlpc350, Dlpc350Policy, EmulatedHid, FlashImage, Pulse, UsbFault

WIDTH, HEIGHT = SIZE
OK, ERROR = 0x40, 0x60


def flat(green: int, red: int, blue: int) -> FlashImage:
    return np.broadcast_to(np.array([green, red, blue], np.uint8), (HEIGHT, WIDTH, 3))


FLASH = [flat(10 * i + 1, 10 * i + 2, 10 * i + 3) for i in range(4)]
"""Uniform grey levels 1, 2, 3 in image 0; 11, 12, 13 in image 1 and so on."""


@dataclass
class Host:
    """Sends bytes as a client does."""

    policy: Dlpc350Policy
    faults: dict[int, UsbFault] | None = None

    def __post_init__(self) -> None:
        self.clock = SteppedClock()
        self.pulses: list[Pulse] = []
        self.controller = Dlpc350(self.clock, FLASH, self.policy, self.pulses.append)
        self.hid = EmulatedHid(self.controller, faults=self.faults)
        self.open()

    def open(self) -> None:
        self.device = self.hid.device()
        self.device.open_path(b"emulated:0")

    def send(self, words: str, flags: int = 0x40, sequence: int = 7) -> bytes:
        """Send a command and its data in hex; return the whole reply, empty if there is none."""
        payload = bytes.fromhex(words)
        payload = payload[1::-1] + payload[2:]  # written as 1A24, sent as 24 1A
        whole = bytes([flags, sequence]) + len(payload).to_bytes(2, "little") + payload
        for i in range(0, len(whole), 64):
            assert self.device.write(b"\0" + whole[i : i + 64].ljust(64, b"\xaa")) == 65
        reply = bytes(self.device.read(64, 50))
        while reply and len(reply) < 4 + int.from_bytes(reply[2:4], "little"):
            reply += bytes(self.device.read(64, 50))
        return reply[: 4 + int.from_bytes(reply[2:4], "little")]

    def write(self, words: str) -> int:
        """Return the flags of the reply."""
        return self.send(words)[0]

    def read(self, words: str) -> bytes:
        """Return the data of the reply."""
        reply = self.send(words, 0xC0)
        assert reply[0] == 0xC0, f"{words} was refused"
        return reply[4:]

    def pattern_mode(self) -> None:
        self.write("1a1b 01")
        self.clock.sleep(1.0)

    def tables(self, entries: str, images: str, mode: str = "01") -> None:
        """Write trigger mode, pattern table and image table."""
        self.write(f"1a23 {mode}")
        for mailbox, data in (("02", entries), ("01", images)):
            assert self.write(f"1a33 {mailbox}") == OK
            assert self.write("1a32 00") == OK
            assert self.write(f"1a34 {data}") == OK
            assert self.write("1a33 00") == OK

    def sequence(
        self,
        entries: str = "007804 047800 087800",
        images: str = "00",
        repeat: int = 1,
        exposure_us: int = 10_000,
        period_us: int = 10_000,
        patterns: int | None = None,
        mode: str = "01",
    ) -> None:
        """Set pattern mode and a sequence, by default of the three 8-bit patterns of image 0."""
        count, swaps = len(bytes.fromhex(entries)) // 3, len(bytes.fromhex(images))
        self.pattern_mode()
        self.write(f"1a31 {count - 1:02x} {repeat:02x} {(patterns or count) - 1:02x} {swaps - 1:02x}")
        times = exposure_us.to_bytes(4, "little") + period_us.to_bytes(4, "little")
        self.write(f"1a29 {times.hex()}")
        self.tables(entries, images, mode)

    def validate(self) -> int:
        """Return the result of a validation, once it is there."""
        assert self.write("1a1a 00") == OK
        for _ in range(100):
            verdict = self.read("1a1a")[0]
            if not verdict & 0x80:
                return verdict
            self.clock.sleep(0.01)
        raise AssertionError("busy for ever")

    def run(self, **changes: Any) -> None:
        """Set, validate and start a sequence."""
        self.sequence(**changes)
        assert self.validate() == 0
        assert self.write("1a24 02") == OK

    def grey(self) -> int:
        light = self.controller.light()
        return -1 if light is None else int(light.grey[0, 0])

    def greys(self, count: int, step_s: float = 0.01) -> list[int]:
        seen = []
        self.clock.sleep(step_s / 2)
        for _ in range(count):
            seen.append(self.grey())
            self.clock.sleep(step_s)
        return seen

    @property
    def running(self) -> bool:
        return bool(self.read("1a0c")[0] & 2)
