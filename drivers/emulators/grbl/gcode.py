"""The part of GRBL 1.1's G-code that moves a stage: what a line means, or the number of its error.

Known: G0 G1 G4 G10 (L2, L20) G17 G20 G21 G53 to G59 G90 G91 G92 G92.1 G94, with F, N and axis words.
Everything else, arcs, probing and spindle among it, is refused as unsupported (error 20).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

MM_PER_INCH = 25.4
AXES = "XYZ"
SYSTEMS = (54.0, 55.0, 56.0, 57.0, 58.0, 59.0)
"""G codes of the work coordinate systems."""

AxisPositions = tuple[float, float, float]
"""X, Y and Z in mm."""
ORIGIN: AxisPositions = (0.0, 0.0, 0.0)

_GROUP = {
    **dict.fromkeys((4.0, 10.0, 53.0, 92.0, 92.1), "once"),
    **dict.fromkeys((0.0, 1.0), "motion"),
    **dict.fromkeys((20.0, 21.0), "units"),
    **dict.fromkeys((90.0, 91.0), "distance"),
    **dict.fromkeys(SYSTEMS, "system"),
    17.0: "plane",
    94.0: "feed",
}
_IN_A_JOG = {"units", "distance"}
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)"
"""How GRBL writes and reads numbers: without exponents."""
_WORD = re.compile(rf"([A-Z])({NUMBER})?")


class GcodeError(Exception):
    """A line that is not executed."""

    def __init__(self, code: int) -> None:
        super().__init__(f"error:{code}")
        self.code = code


@dataclass(frozen=True)
class Move:
    """A straight move."""

    target: AxisPositions  # machine position in mm
    rate_mm_s: float | None  # speed in mm/s; None for the greatest possible


@dataclass(frozen=True)
class Dwell:
    """A pause after all motion has ended."""

    seconds: float  # its length in s


@dataclass
class GcodeBlock:
    """The words of one line."""

    commands: dict[str, float] = field(default_factory=dict)  # G codes by modal group
    values: dict[str, float] = field(default_factory=dict)  # values of the other words by letter

    @property
    def has_axes(self) -> bool:
        """Whether X, Y or Z is given."""
        return any(axis in self.values for axis in AXES)


def read_block(line: str) -> GcodeBlock:
    """Split a line into words."""
    block, at = GcodeBlock(), 0
    while at < len(line):
        found = _WORD.match(line, at)
        if found is None:
            raise GcodeError(1)
        if found[2] is None:
            raise GcodeError(2)
        _add(block, found[1], float(found[2]))
        at = found.end()
    return block


def _add(block: GcodeBlock, letter: str, value: float) -> None:
    if letter == "G":
        if value not in _GROUP:
            raise GcodeError(20)
        if _GROUP[value] in block.commands:
            raise GcodeError(21)
        block.commands[_GROUP[value]] = value
        return
    if letter not in "FLNPXYZ":
        raise GcodeError(20)
    if letter in block.values:
        raise GcodeError(25)
    if letter in "FNP" and value < 0:
        raise GcodeError(4)
    block.values[letter] = value


class Interpreter:
    """The modal state from one line to the next, and the work coordinate systems."""

    def __init__(self) -> None:
        self.systems = [ORIGIN] * len(SYSTEMS)
        self.reset()

    def reset(self) -> None:
        """Restore the power-on modes; the work coordinate systems are kept."""
        self.motion, self.inches, self.relative, self.system = 0.0, False, False, 0
        self.feed_mm_s: float | None = None
        self.shift = ORIGIN

    @property
    def offset(self) -> AxisPositions:
        """Machine position in mm of the work zero."""
        x, y, z = (a + b for a, b in zip(self.systems[self.system], self.shift, strict=True))
        return x, y, z

    def modes(self) -> str:
        """Compose the answer to `$G`."""
        words = [
            self.motion,
            SYSTEMS[self.system],
            17,
            20 if self.inches else 21,
            91 if self.relative else 90,
            94,
        ]
        feed = (self.feed_mm_s or 0.0) * 60 / (MM_PER_INCH if self.inches else 1.0)
        return f"[GC:{' '.join(f'G{word:g}' for word in words)} M5 M9 T0 F{feed:.0f} S0]"

    def execute(self, line: str, here: AxisPositions) -> Move | Dwell | None:
        """Interpret a line of G-code."""
        block = read_block(line)
        once = block.commands.get("once")
        if once == 4.0 and "P" not in block.values:
            raise GcodeError(28)
        if once in (10.0, 92.0) and not block.has_axes:
            raise GcodeError(26)
        if once == 10.0 and (block.values.get("L") not in (2.0, 20.0) or "P" not in block.values):
            raise GcodeError(28)
        if once == 10.0 and block.values["P"] not in range(len(SYSTEMS) + 1):
            raise GcodeError(29)
        moves = block.has_axes and once not in (4.0, 10.0, 92.0)
        motion = block.commands.get("motion", self.motion)
        feed = self._feed(block) or self.feed_mm_s
        if moves and motion == 1.0 and not feed:
            raise GcodeError(22)
        self._take_modes(block, motion, feed)
        if once == 4.0:
            return Dwell(block.values["P"])
        if once in (10.0, 92.0, 92.1):
            self._take_offset(once, block, here)
            return None
        if not moves:
            return None
        return Move(self._target(block, here, self.relative), feed if motion == 1.0 else None)

    def jog(self, line: str, here: AxisPositions) -> Move:
        """Interpret a jog command; its modes hold for this line alone."""
        block = read_block(line)
        absolute = block.commands.pop("once", None)
        if absolute not in (None, 53.0) or not block.commands.keys() <= _IN_A_JOG:
            raise GcodeError(16)
        if not block.has_axes:
            raise GcodeError(26)
        feed = self._feed(block)
        if not feed:
            raise GcodeError(22)
        if absolute:
            block.commands["once"] = absolute
        relative = block.commands.get("distance", 91.0 if self.relative else 90.0) == 91.0
        return Move(self._target(block, here, relative), feed)

    def _scale(self, block: GcodeBlock) -> float:
        inches = block.commands.get("units", 20.0 if self.inches else 21.0) == 20.0
        return MM_PER_INCH if inches else 1.0

    def _feed(self, block: GcodeBlock) -> float | None:
        return block.values["F"] * self._scale(block) / 60 if "F" in block.values else None

    def _take_modes(self, block: GcodeBlock, motion: float, feed: float | None) -> None:
        self.motion, self.feed_mm_s = motion, feed
        self.inches = self._scale(block) != 1.0
        self.relative = block.commands.get("distance", 91.0 if self.relative else 90.0) == 91.0
        self.system = SYSTEMS.index(block.commands.get("system", SYSTEMS[self.system]))

    def _target(self, block: GcodeBlock, here: AxisPositions, relative: bool) -> AxisPositions:
        scale, machine = self._scale(block), block.commands.get("once") == 53.0
        target = list(here)
        for i, axis in enumerate(AXES):
            if axis in block.values:
                base = 0.0 if machine else here[i] if relative else self.offset[i]
                target[i] = base + block.values[axis] * scale
        return target[0], target[1], target[2]

    def _take_offset(self, once: float, block: GcodeBlock, here: AxisPositions) -> None:
        if once == 92.1:
            self.shift = ORIGIN
            return
        given = {i: block.values[a] * self._scale(block) for i, a in enumerate(AXES) if a in block.values}
        if once == 92.0:
            base = self.systems[self.system]
            self.shift = _with(self.shift, {i: here[i] - base[i] - mm for i, mm in given.items()})
            return
        number = int(block.values["P"]) - 1 if block.values["P"] else self.system
        if block.values["L"] == 20.0:
            given = {i: here[i] - self.shift[i] - mm for i, mm in given.items()}
        self.systems[number] = _with(self.systems[number], given)


def _with(vector: AxisPositions, changed: dict[int, float]) -> AxisPositions:
    x, y, z = (changed.get(i, mm) for i, mm in enumerate(vector))
    return x, y, z
