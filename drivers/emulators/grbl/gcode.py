"""The lines of G-code that the stage's driver sends: what each means, or the number of its error.

A move is `G90 G21 G53 G0` and one axis word; `G4 P0` is answered when all motion has ended. What a line
leaves out is as another program has left it, so that a driver that relies on it goes wrong, as it would with
a real controller. Everything else is refused as unsupported (error 20).
"""

import re
from dataclasses import dataclass

from drivers.stage_grbl.lines import AXES
from fpplab.core.units import MM_PER_INCH

AxisPositions = tuple[float, float, float]  # X, Y and Z in mm
ORIGIN: AxisPositions = (0.0, 0.0, 0.0)

_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))?")  # GRBL reads numbers without exponents
_COMMANDS = {0.0, 4.0, 21.0, 53.0, 90.0}


class GcodeError(Exception):
    """A line that is not executed."""

    def __init__(self, code: int) -> None:
        super().__init__(f"error:{code}")
        self.code = code


@dataclass
class Modes:
    """How positions are meant where a line does not say."""

    in_inches: bool = False  # G20 instead of G21
    is_relative: bool = False  # G91 instead of G90
    offset: AxisPositions = ORIGIN  # machine position in mm of the work zero, where G53 is left out


@dataclass(frozen=True)
class Block:
    """The words of one line."""

    commands: frozenset[float]  # numbers behind G
    values: dict[str, float]  # numbers behind the other letters


def read_block(line: str) -> Block:
    commands: set[float] = set()
    values: dict[str, float] = {}
    position = 0
    while position < len(line):
        word = _WORD.match(line, position)
        if word is None:
            raise GcodeError(1)
        if word[2] is None:
            raise GcodeError(2)
        letter, value = word[1], float(word[2])
        position = word.end()
        if letter not in "GPXYZ" or (letter == "G" and value not in _COMMANDS):
            raise GcodeError(20)
        if letter == "G" and value in commands:
            raise GcodeError(21)
        if letter in values:
            raise GcodeError(25)
        if letter == "G":
            commands.add(value)
        else:
            values[letter] = value
    return Block(frozenset(commands), values)


@dataclass(frozen=True)
class Move:
    """A straight move along one axis."""

    axis: int  # 0, 1 or 2
    target_mm: float  # machine position


def interpret(block: Block, modes: Modes, position: AxisPositions) -> Move | None:
    """Return the move that a line asks for, if it asks for one; modes that it sets stay so."""
    modes.in_inches &= 21.0 not in block.commands
    modes.is_relative &= 90.0 not in block.commands
    axes = [i for i, letter in enumerate(AXES) if letter in block.values]
    if 4.0 in block.commands:
        if block.values != {"P": 0.0}:
            raise GcodeError(28 if "P" not in block.values else 20)
        return None
    if not axes:
        return None
    if len(axes) > 1:
        raise GcodeError(20)
    (axis,) = axes
    base_mm = modes.offset[axis]
    if 53.0 in block.commands:
        base_mm = 0.0
    elif modes.is_relative:
        base_mm = position[axis]
    return Move(axis, base_mm + block.values[AXES[axis]] * (MM_PER_INCH if modes.in_inches else 1.0))
