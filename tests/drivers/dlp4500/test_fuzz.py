"""Random and mutated reports into the emulator and into the driver: no crash, no hang, no wrong success."""

import random
from collections import Counter, deque

import pytest

from drivers.clock import SteppedClock
from drivers.dlp4500 import protocol
from drivers.dlp4500.framing import MAX_PAYLOAD_BYTES, continuation_reports
from drivers.dlp4500.layout import Command, RawBytes, RegisterLayout
from drivers.dlp4500.protocol import COMMANDS
from drivers.dlp4500.transport import Link
from drivers.emulators.dlpc350 import Dlpc350, Dlpc350Policy, EmulatedHid, UsbFault
from fpplab.core.errors import DeviceError
from fpplab.devices import State
from tests.drivers.dlp4500.test_faults import LONGEST_S, Trial
from tests.drivers.dlpc350_host import FLASH
from tests.drivers.projector_bench import Bench, greys

KNOWN = list(COMMANDS.values())


def mutated(report: bytes, chance: random.Random) -> bytes:
    """With up to three bytes changed, most often among the first."""
    changed = bytearray(report)
    for _ in range(chance.choice((0, 0, 1, 1, 2, 3))):
        changed[int(len(changed) * chance.random() ** 3)] = chance.getrandbits(8)
    return bytes(changed)


def data_for(layout: RegisterLayout | RawBytes | None, chance: random.Random) -> bytes:
    """Data that a layout takes, or nearly."""
    if layout is None:
        return b""
    if isinstance(layout, RawBytes):
        return chance.randbytes(chance.randint(layout.min_bytes, min(layout.max_bytes, 200)))
    return layout.pack(
        {f.name: chance.choice((f.values()[0], chance.choice(f.values()))) for f in layout.named}
    )


def some_request(chance: random.Random) -> list[bytes]:
    """The reports of a request: valid, mutated or without any meaning."""
    if chance.random() < 0.2:
        return [chance.randbytes(64)]
    command = chance.choice(KNOWN)
    reads = chance.random() < 0.4
    data = data_for(command.selector if reads else command.written, chance)
    payload = command.number.to_bytes(2, "little") + data
    flags = chance.choice((0xC0, 0xC0, 0x80)) if reads else chance.choice((0x40, 0x40, 0x00))
    whole = bytes([flags, chance.getrandbits(8)]) + len(payload).to_bytes(2, "little") + payload
    reports = [whole[i : i + 64].ljust(64, b"\0") for i in range(0, len(whole), 64)]
    return [mutated(report, chance) for report in reports]


class Expected:
    """What the wire owes: it follows the framing by itself, and knows no command."""

    def __init__(self) -> None:
        self.left = 0
        self.head = b""

    def take(self, report: bytes) -> bytes | None:
        """The header and command of the message that is whole with this report."""
        if self.left:
            self.left -= 1
        else:
            length = int.from_bytes(report[2:4], "little")
            if length > MAX_PAYLOAD_BYTES:
                return None
            self.head, self.left = report[:6], max(0, -(-(length - 60) // 64))
        return None if self.left else self.head


def batter_emulator(reports: int, seed: int) -> Counter[str]:
    """Send that many reports; what came of the messages in them."""
    chance = random.Random(seed)
    clock = SteppedClock()
    controller = Dlpc350(clock, FLASH, Dlpc350Policy())
    hid = EmulatedHid(controller)
    wire, expected, fates = hid.device(), Expected(), Counter[str]()
    wire.open_path(b"emulated:0")
    waiting: deque[bytes] = deque()
    for _ in range(reports):
        if not waiting:
            waiting.extend(some_request(chance))
        report = waiting.popleft()
        if wire.write(b"\0" + report) != 65:
            clock.sleep(10.0)  # it was told to reset
            wire, expected = hid.device(), Expected()
            wire.open_path(b"emulated:0")
            fates["reset"] += 1
            continue
        head = expected.take(report)
        fates[check_reply(wire.read(64, 1) if hid.is_plugged else [], head, wire)] += 1
    return fates


def check_reply(reply: list[int], head: bytes | None, wire: object) -> str:
    """One reply to a message that wants one, none to others, and no success for what does not exist."""
    if head is None or not head[0] & 0x40 or head[0] & 0x07:
        assert not reply
        return "unanswered"
    length = int.from_bytes(head[2:4], "little")
    number = int.from_bytes(head[4:6], "little")
    if not reply:
        assert number == protocol.SOFTWARE_RESET.number
        return "reset"
    assert reply[1] == head[1]
    assert reply[0] | 0x20 == head[0] | 0x20
    if reply[0] & 0x20 and not head[0] & 0x20:
        return "refused"
    told = int.from_bytes(bytes(reply[2:4]), "little")
    for _ in range(continuation_reports(told)):
        assert len(wire.read(64, 1)) == 64
    if head[0] & 0x20:
        return "asked with the error bit"
    command = COMMANDS[number]
    layout = command.selector if head[0] & 0x80 else command.written
    assert isinstance(layout, RawBytes) or length == 2 + layout.size
    return "answered"


def test_the_emulator_answers_what_it_should_and_no_more() -> None:
    fates = batter_emulator(20_000, 1)
    assert fates["answered"] > 1000
    assert fates["refused"] > 1000
    assert fates["reset"] > 10


class LyingWire:
    """Answers with anything: right, mutated, of another request, cut, doubled, or nothing."""

    def __init__(self, clock: SteppedClock, chance: random.Random) -> None:
        self.clock, self.chance = clock, chance
        self.asked: Command = protocol.SEQUENCE
        self.waiting: deque[bytes] = deque()
        self.given: list[bytes] = []
        self.head = b""

    def write(self, buff: bytes) -> int:
        self.head = bytes(buff[1:3])
        self.given.clear()
        self.waiting.extend(self.reply())
        return -1 if self.chance.random() < 0.005 else len(buff)

    def reply(self) -> list[bytes]:
        chance = self.chance
        returned = self.asked.returned if self.head[0] & 0x80 else None
        data = data_for(returned, chance)
        right = (self.head + len(data).to_bytes(2, "little") + data).ljust(64, b"\0")
        kind = chance.randrange(8)
        if kind == 0:
            return [chance.randbytes(64)]
        if kind == 1:
            return [right[: chance.randrange(64)]]
        if kind == 2:
            return []
        return [mutated(right, chance) for _ in range(chance.choice((1, 1, 1, 2)))]

    def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
        assert timeout_ms > 0
        if not self.waiting:
            self.clock.sleep(timeout_ms / 1000)
            return []
        if self.chance.random() < 0.005:
            raise OSError("read error")
        self.given.append(self.waiting.popleft())
        return list(self.given[-1])

    def close(self) -> None: ...


SHORT_COMMANDS = [
    c for c in KNOWN if not isinstance(c.written, RawBytes) and not isinstance(c.returned, RawBytes)
]


def batter_driver(requests: int, seed: int) -> Counter[str]:
    """Ask that many times; what came of it."""
    chance = random.Random(seed)
    clock = SteppedClock()
    wire = LyingWire(clock, chance)
    link = Link(wire, clock, "projector")
    fates = Counter[str]()
    for _ in range(requests):
        command = wire.asked = chance.choice(SHORT_COMMANDS)
        before = clock.now()
        try:
            fates[ask(link, wire, command, chance)] += 1
        except DeviceError as error:
            fates[type(error).__name__] += 1
        assert clock.now() - before < LONGEST_S
    return fates


def ask(link: Link, wire: LyingWire, command: Command, chance: random.Random) -> str:
    """One question or order; success only for an answer that bears its flags and its number."""
    if command.returned is not None and chance.random() < 0.6:
        assert isinstance(command.returned, RegisterLayout)
        found = link.read(command)
        size = command.returned.size
        answer = wire.given[-1]
        assert answer[:2] == wire.head
        assert int.from_bytes(answer[2:4], "little") == size
        assert command.returned.unpack(answer[4 : 4 + size]) == found
        return "read"
    if command.written is None:
        return "nothing"
    assert isinstance(command.written, RegisterLayout)
    link.write(command, **{f.name: f.values()[0] for f in command.written.named})
    assert not command.acknowledged or wire.given[-1][:2] == wire.head
    return "written"


def test_the_driver_believes_no_wrong_answer() -> None:
    fates = batter_driver(10_000, 2)
    for kind in ("read", "written", "DeviceTimeoutError", "ProtocolError", "DisconnectedError"):
        assert fates[kind] > 20, kind


@pytest.mark.nightly
def test_a_million_reports() -> None:
    assert batter_emulator(600_000, 3).total() + batter_driver(400_000, 4).total() == 1_000_000


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Bench:
    return Bench(greys(2), tmp_path_factory.mktemp("flash"))


def test_many_faults_at_once_leave_it_dark_or_never_lit(bench: Bench) -> None:
    """Whatever happens on the wire ends in time, and with the cable in nothing stays lit for long."""
    chance = random.Random(5)
    kinds = [UsbFault.DROP, UsbFault.LATE, UsbFault.DUPLICATE, UsbFault.NACK, UsbFault.SHORT]
    for _ in range(40):
        trial = Trial(bench)
        trial.hid.faults = {at: chance.choice(kinds) for at in range(200) if chance.random() < 0.05}
        try:
            trial.measure()
        except DeviceError:
            trial.hid.faults = {}
            trial.projector.close()
        assert trial.projector.state is State.CLOSED
        assert trial.grey() is None
        assert trial.clock.now() < 3 * LONGEST_S
