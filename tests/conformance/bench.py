"""What the conformance tests have in common: a plan that any rig can show, and how to look at it."""

from contextlib import suppress
from dataclasses import replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
import pytest
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError, FrameLossError
from fpplab.devices import Device, Frame
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.plan import Plan

EXPOSURE_S = 0.02
FLAT = Sinusoid(axis="x", stripes=0.01, steps=4)
"""So few stripes that step 0 is white all over and step 2 is black."""
COLUMNS = Sinusoid(axis="x", stripes=4, steps=4)
ROWS = Sinusoid(axis="y", stripes=4, steps=4)

WHITE, GREY, BLACK = 0, 1, 2
DISTINCT = (0, 2, 4, 5, 6, 7, 8, 9, 10, 11)
"""Indices of patterns that no two look alike."""


@runtime_checkable
class LosesFrames(Protocol):
    """A rig file's `bench` that can lose frames on the link from its camera, as an emulated one can."""

    def lose_frames(self, n: int) -> None:
        """Lose the next `n` frames: they are exposed and counted by the camera, and never arrive."""
        ...


def dim_plan(rig: Rig) -> Plan:
    """White, black and four-step columns and rows, at an exposure that the camera has."""
    least, most = rig.camera.caps.exposure_s
    return Plan(fringes=(FLAT, COLUMNS, ROWS), exposure_s=min(max(EXPOSURE_S, least), most))


def patterns_for(rig: Rig) -> list[Pattern]:
    """The patterns of the plan, for a test to keep or to spoil."""
    caps = rig.projector.caps
    made = make_patterns(dim_plan(rig), caps.size, caps.lattice)
    return [replace(pattern, image=pattern.image.copy()) for pattern in made]


def devices_of(rig: Rig) -> list[Device]:
    return [d for d in (rig.camera, rig.projector, rig.stage, rig.fixture) if d is not None]


def picture(rig: Rig, i: int) -> Floats:
    """What the camera sees of loaded pattern `i`, as a share of full scale."""
    rig.projector.show(i)
    return seen(rig)


def seen(rig: Rig) -> Floats:
    frame = rig.camera.snap()
    return frame.image / float((1 << frame.settings.bits) - 1)


def contrast(frame: Frame) -> float:
    """What most of a picture spans, as a share of full scale: a black level does not count."""
    low, high = np.quantile(frame.image, (0.05, 0.95))
    return float(high - low) / (1 << frame.settings.bits)


def check_unknown_key(rig: Rig, device: Device) -> None:
    """Fail where a driver takes any key: one that is misspelt would have no effect."""

    def make() -> None:
        options = {**rig._options(getattr(rig.file, device.kind)), "no_such_key": 1}
        type(device)(device.name, options, rig.simulation)

    with suppress(ConfigError):
        make()
        pytest.fail(
            "a key that does not exist was accepted: end `_setup` with `super()._setup(options, shared)`"
        )
    with pytest.raises(ConfigError, match="no_such_key"):
        make()


def brightness(picture: NDArray[Any]) -> float:
    """Of the brightest tenth, so that it does not matter how much of the view is lit."""
    return float(np.quantile(picture, 0.9))


def is_dark(rig: Rig) -> bool:
    """Whether nothing is on show: the camera sees less than of a black pattern, or says it saw none."""
    rig.projector.load(patterns_for(rig))
    black = brightness(picture(rig, BLACK))
    white = brightness(picture(rig, WHITE))
    rig.projector.blank()
    return dark_now(rig, black, white)


def dark_now(rig: Rig, black: float, white: float) -> bool:
    """Whether the camera sees nothing now; where darkness was never recorded it refuses a picture."""
    try:
        return brightness(seen(rig)) < black + 0.1 * (white - black)
    except FrameLossError:
        return True
