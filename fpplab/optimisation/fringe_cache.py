"""A cache of fringe sets, each acquired once, from which the measurements of plans are put together.

A set of N steps is also taken from the images of one with a multiple of N. On a simulation candidates are
compared with common random numbers: the noise of an image depends on the seed, the item, the position of its
set in the plan and its phase shift alone, so not on the order of measurements or the process.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from fpplab.acquisition.acquire import capture
from fpplab.core.conventions import Axis, Floats, Image, axis_length
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Seeded
from fpplab.patterns.fringe_sets import PatternSet
from fpplab.patterns.plan import Plan


@dataclass(frozen=True)
class MeasuringSetup:
    """Everything but the fringes that an image depends on."""

    item: str  # item of the fixture that the camera looks at
    exposure_s: float  # exposure of every image in seconds
    stage_mm: float | None = None  # position of the stage in mm; None leaves it
    convergence_deg: float | None = None  # rotation of the projector towards the camera in degrees
    taken: int = 0  # how often every image was taken before, at other exposures


class _Key(NamedTuple):
    """What images are equal by."""

    setup: MeasuringSetup
    shown: bytes  # digest of the light along the axis
    axis: Axis | None
    bits: int  # of the pattern
    seed: int
    place: int  # position of the set in the plan if the noise depends on it, else 0
    share: Fraction  # of the set's images that come before


class FringeSetCache:
    """The frames of pattern sets on an open rig, acquired when they are first asked for."""

    def __init__(
        self,
        rig: Rig,
        template: Plan,
        arrange: Callable[[MeasuringSetup], None],
        keep_bytes: int = 3 << 28,  # chosen: 0.8 GB of frames
    ) -> None:
        self._rig, self._template, self._arrange, self._limit = rig, template, arrange, keep_bytes
        self._seeded = rig.simulation if isinstance(rig.simulation, Seeded) else None
        self._kept: OrderedDict[_Key, Image] = OrderedDict()
        self.acquired = 0
        """Images taken since the beginning."""

    def frames(self, setup: MeasuringSetup, sets: Sequence[PatternSet], seed: int) -> list[Image]:
        # returns (height, width)
        keys = [self._keys(setup, each, place, seed) for place, each in enumerate(sets)]
        missing = [i for i, images in enumerate(keys) if not all(key in self._kept for key in images)]
        if missing:
            self._arrange(setup)
            self._acquire(setup, tuple(sets[i] for i in missing), [k for i in missing for k in keys[i]])
        used = [key for images in keys for key in images]
        frames = [self._kept[key] for key in used]
        self._evict_unused(used)
        return frames

    def _keys(self, setup: MeasuringSetup, shown: PatternSet, place: int, seed: int) -> list[_Key]:
        length = axis_length(self._rig.projector.caps.size, shown.coded_axis or "x")
        pixels, place = np.arange(length, dtype=np.float64), place if self._seeded else 0
        of_set = shown.coded_axis, shown.bit_depth, seed, place
        return [
            _Key(setup, _digest(shown.light(n, pixels, length)), *of_set, Fraction(n, shown.images))
            for n in range(shown.images)
        ]

    def _acquire(self, setup: MeasuringSetup, sets: tuple[PatternSet, ...], keys: list[_Key]) -> None:
        if self._seeded is not None:
            self._seeded.draw(noise_number(key) for key in keys)
        plan = self._template.model_copy(
            update={"fringes": sets, "exposure_s": setup.exposure_s, "exposures_s": None}
        )
        self._kept.update(zip(keys, capture(self._rig, plan), strict=True))
        self.acquired += plan.images

    def _evict_unused(self, used: Iterable[_Key]) -> None:
        for key in used:
            self._kept.move_to_end(key)
        held = sum(frame.nbytes for frame in self._kept.values())
        while held > self._limit and len(self._kept) > 1:
            held -= self._kept.popitem(last=False)[1].nbytes


def _digest(light: Floats) -> bytes:
    """Digest of a pattern: equal for images of sets with other numbers of steps, which differ by rounding."""
    return hashlib.blake2b((np.round(light, 9) + 0.0).tobytes(), digest_size=16).digest()


def noise_number(key: _Key) -> int:
    # It depends neither on the pattern nor on the number of steps, so that similar candidates have equal
    # noise.
    again = (key.setup.taken,) if key.setup.taken else ()
    parts = key.seed, key.setup.item, key.axis, key.place, key.share, *again
    digest = hashlib.blake2b("/".join(map(str, parts)).encode(), digest_size=7)
    return int.from_bytes(digest.digest(), "big")
