"""Data of the DLPC350's commands as bit fields, and what a command is.

A `RegisterLayout` lists bit fields, lowest first, which is at once the order of bits in a byte and of bytes
in a number: everything multi-byte is little-endian. Values are checked both when packed and when unpacked,
so that neither a wrong call nor a wrong reply goes unnoticed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

Values = dict[str, int]


@dataclass(frozen=True)
class RegisterField:
    """One number in a register."""

    name: str  # name of the value
    bits: int  # width in bits
    allowed: Sequence[int] = ()  # allowed values; empty for all that the bits hold
    offset: int = 0  # subtracted from the value when it is packed, added when it is unpacked

    def values(self) -> Sequence[int]:
        return self.allowed or range(self.offset, (1 << self.bits) + self.offset)

    def check(self, value: int) -> None:
        allowed = self.values()
        if value not in allowed:
            expected = f"{allowed[0]} to {allowed[-1]}" if isinstance(allowed, range) else f"one of {allowed}"
            raise ValueError(f"{self.name} is {value}: {expected}")


@dataclass(frozen=True)
class RegisterLayout:
    """Bit fields, from the lowest bit of the first byte on."""

    fields: tuple[RegisterField, ...] = ()  # the fields, reserved ones included

    @property
    def size(self) -> int:
        return sum(field.bits for field in self.fields) // 8

    @property
    def named(self) -> list[RegisterField]:
        return [field for field in self.fields if field.name]

    def pack(self, values: Mapping[str, int]) -> bytes:
        names = {field.name for field in self.named}
        if names != set(values):
            raise ValueError(f"the fields are {sorted(names)}, given are {sorted(values)}")
        word, at = 0, 0
        for field in self.fields:
            if field.name:
                field.check(values[field.name])
                word |= (values[field.name] - field.offset) << at
            at += field.bits
        return word.to_bytes(self.size, "little")

    def unpack(self, data: bytes) -> Values:
        if len(data) != self.size:
            raise ValueError(f"{len(data)} bytes of data: {self.size}")
        word, values = int.from_bytes(data, "little"), {}
        for field in self.fields:
            if field.name:
                values[field.name] = (word & ((1 << field.bits) - 1)) + field.offset
                field.check(values[field.name])
            word >>= field.bits
        return values


@dataclass(frozen=True)
class RawBytes:
    """Data without a bit-field layout."""

    min_bytes: int
    max_bytes: int

    def check(self, data: bytes) -> None:
        if not self.min_bytes <= len(data) <= self.max_bytes:
            raise ValueError(f"{len(data)} bytes of data: {self.min_bytes} to {self.max_bytes}")


Layout = RegisterLayout | RawBytes


@dataclass(frozen=True)
class Command:
    """One command of the controller."""

    name: str  # name of the command, for errors
    number: int  # number of the command, 16 bits
    written: Layout | None = None  # data of a write; None for a command that can only be read
    returned: Layout | None = None  # data of the reply to a read; None for a command that can only be written
    selector: RegisterLayout = RegisterLayout()  # data of a read request
    acknowledged: bool = True  # whether a write asks for a reply
