"""Data of the DLPC350's commands as bit fields, and what a command is.

A `RegisterLayout` lists bit fields, lowest first, which is at once the order of bits in a byte and of bytes
in a number: everything multi-byte is little-endian. Values are checked both when packed and when unpacked,
so that neither a wrong call nor a wrong reply goes unnoticed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

Values = dict[str, int]


@dataclass(frozen=True)
class RegisterField:
    """One number in a register.

    Attributes
    ----------
    name : str
        Name of the value; empty for reserved bits, which are zero when packed and ignored when unpacked.
    bits : int
        Width in bits.
    allowed : sequence of int
        Allowed values; empty for all that the bits hold.
    offset : int
        Subtracted from the value when it is packed, added when it is unpacked.
    """

    name: str
    bits: int
    allowed: Sequence[int] = ()
    offset: int = 0

    def values(self) -> Sequence[int]:
        """List the allowed values.

        Returns
        -------
        sequence of int
            `allowed`, or the range that the bits hold.
        """
        return self.allowed or range(self.offset, (1 << self.bits) + self.offset)

    def check(self, value: int) -> None:
        """Check that a value is allowed.

        Parameters
        ----------
        value : int
            The value.

        Raises
        ------
        ValueError
            It is not allowed.
        """
        allowed = self.values()
        if value not in allowed:
            words = f"{allowed[0]} to {allowed[-1]}" if isinstance(allowed, range) else f"one of {allowed}"
            raise ValueError(f"{self.name} is {value}: {words}")


@dataclass(frozen=True)
class RegisterLayout:
    """Bit fields, from the lowest bit of the first byte on.

    Attributes
    ----------
    fields : tuple of RegisterField
        The fields, reserved ones included.
    """

    fields: tuple[RegisterField, ...] = ()

    @property
    def size(self) -> int:
        """Size in bytes."""
        return sum(field.bits for field in self.fields) // 8

    @property
    def named(self) -> list[RegisterField]:
        """The fields that are not reserved."""
        return [field for field in self.fields if field.name]

    def pack(self, values: Mapping[str, int]) -> bytes:
        """Encode values.

        Parameters
        ----------
        values : mapping of str to int
            A value for each field that is not reserved.

        Returns
        -------
        bytes
            The encoded fields, `size` bytes.

        Raises
        ------
        ValueError
            A field is missing, unknown or out of range.
        """
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
        """Decode values.

        Parameters
        ----------
        data : bytes
            The encoded fields.

        Returns
        -------
        dict of str to int
            A value for each field that is not reserved.

        Raises
        ------
        ValueError
            The size is wrong, or a field is out of range.
        """
        if len(data) != self.size:
            raise ValueError(f"{len(data)} bytes of data: {self.size}")
        word, found = int.from_bytes(data, "little"), {}
        for field in self.fields:
            if field.name:
                found[field.name] = (word & ((1 << field.bits) - 1)) + field.offset
                field.check(found[field.name])
            word >>= field.bits
        return found


@dataclass(frozen=True)
class RawBytes:
    """Data without a bit-field layout.

    Attributes
    ----------
    least : int
        Smallest number of bytes.
    most : int
        Largest number of bytes.
    """

    least: int
    most: int

    def check(self, data: bytes) -> None:
        """Check the number of bytes.

        Parameters
        ----------
        data : bytes
            The data.

        Raises
        ------
        ValueError
            Their number is out of range.
        """
        if not self.least <= len(data) <= self.most:
            raise ValueError(f"{len(data)} bytes of data: {self.least} to {self.most}")


Layout = RegisterLayout | RawBytes


@dataclass(frozen=True)
class Command:
    """One command of the controller.

    Attributes
    ----------
    name : str
        Name of the command, for errors.
    number : int
        Number of the command, 16 bits.
    written : RegisterLayout or RawBytes or None
        Data of a write; None for a command that can only be read.
    returned : RegisterLayout or RawBytes or None
        Data of the reply to a read; None for a command that can only be written.
    selector : RegisterLayout
        Data of a read request.
    acknowledged : bool
        Whether a write asks for a reply.
    """

    name: str
    number: int
    written: Layout | None = None
    returned: Layout | None = None
    selector: RegisterLayout = RegisterLayout()
    acknowledged: bool = True
