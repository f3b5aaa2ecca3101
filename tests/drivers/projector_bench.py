"""An emulated LightCrafter 4500 on an emulated USB connection, with patterns in flash, to test its driver."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.clock import SteppedClock
from drivers.dlp4500 import Dlp4500
from drivers.dlp4500.index import FlashIndex, FlashPattern, shown_image
from drivers.dlp4500.sequence import SIZE, bit_planes
from drivers.emulators.dlpc350 import (
    STRICT,
    Dlpc350,
    Dlpc350Policy,
    EmulatedDisplay,
    EmulatedHid,
    FlashImage,
    Pulse,
    UsbFault,
)
from fpplab.core import config
from fpplab.patterns.fringes import Pattern

WIDTH, HEIGHT = SIZE
FRAME_S = 1 / 60  # of the video port


def put(image: FlashImage, pattern: Pattern, number: int) -> None:
    """Write a pattern into the planes of its number."""
    values = np.rint(shown_image(pattern) / 255.0 * ((1 << pattern.bit_depth) - 1)).astype(np.uint8)
    for bit, plane in enumerate(bit_planes(pattern.bit_depth, number)):
        image[..., plane // 8] |= ((values >> bit) & 1) << (plane % 8)


def packed(patterns: Sequence[Pattern]) -> tuple[list[FlashImage], FlashIndex]:
    """Flash images that hold the patterns: three of 8 bits to an image, one of another depth."""
    images: list[FlashImage] = []
    entries: list[FlashPattern] = []
    room = 0
    for pattern in patterns:
        if pattern.bit_depth != 8 or not room:
            images.append(np.zeros((HEIGHT, WIDTH, 3), np.uint8))
            room = 3 if pattern.bit_depth == 8 else 1
        number = 3 - room if pattern.bit_depth == 8 else 0
        put(images[-1], pattern, number)
        entries.append(FlashPattern.of(pattern, len(images) - 1, number))
        room -= 1
    return images, FlashIndex(patterns=tuple(entries))


def flat(name: str, grey: int, bits: int = 8) -> Pattern:
    """A uniform grey-level image."""
    return Pattern(name, np.full((HEIGHT, WIDTH), grey, np.uint8), bits)


def grey_of(pattern: Pattern) -> int:
    """The grey of a flat pattern."""
    return int(pattern.image[0, 0])


def greys(count: int, bits: int = 8) -> list[Pattern]:
    """Uniform grey-level images, all different, from nearly black to white."""
    return [flat(f"grey-{i:02d}", round(255 * (i + 1) / count), bits) for i in range(count)]


@dataclass
class Bench:
    """The emulated projector, its driver, and all its trigger pulses."""

    patterns: Sequence[Pattern]
    folder: Path
    policy: Dlpc350Policy = STRICT
    faults: Mapping[int, UsbFault] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.clock = SteppedClock()
        images, index = packed(self.patterns)
        self.pulses: list[Pulse] = []
        self.controller = Dlpc350(self.clock, images, self.policy, self.pulses.append)
        self.hid = EmulatedHid(self.controller, faults=self.faults)
        self.flash = self.folder / "flash.yaml"
        self.flash.write_text(config.dump(index), encoding="utf-8")

    def projector(self, **options: Any) -> Dlp4500:
        """Make the driver, not open yet."""
        return Dlp4500("projector", {"flash": str(self.flash), **options}, self)

    def grey(self) -> int:
        """Return the grey level that is projected now; -1 in the dark."""
        light = self.controller.light()
        return int(light.grey[0, 0]) if light is not None else -1

    def is_dark(self) -> bool:
        return self.controller.light() is None

    def watched(self, steps: int, step_s: float) -> list[int]:
        """The grey in the middle of each of the coming steps."""
        seen = []
        self.clock.sleep(step_s / 2)
        for _ in range(steps):
            seen.append(self.grey())
            self.clock.sleep(step_s)
        return seen


class VideoBench(Bench):
    """The projector with a computer's display on its video port. frames: how many it was given."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.frames = 0
        bench = self

        class Counting(EmulatedDisplay):
            def show(self, frame: NDArray[np.uint8]) -> None:
                bench.frames += 1
                super().show(frame)

        self.display = Counting(self.controller, FRAME_S)

    def projector(self, **options: Any) -> Dlp4500:
        return Dlp4500("projector", {"video": {"display": 0}, **options}, self)

    def pulsed(self) -> list[float]:
        """When output 1 rose."""
        return [pulse.rise_s for pulse in self.pulses if pulse.output == 1]
