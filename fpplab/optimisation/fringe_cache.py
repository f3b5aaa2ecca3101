"""Fringe sets, each acquired once: plans are put together from them.

What a search changes most is one frequency, so the fringe set is the unit of measuring. A set of N steps is
also taken from the images of one with a multiple of N: every second of 12 steps are 6, of the same patterns.

Where the rig is a simulation, candidates are compared with common random numbers: the noise of an image
follows from the seed, the item, the place of its set in the plan and its phase shift, and from nothing else.
So it is the same in whatever order candidates are measured and by whomever, and the same image of a set of 6
steps and of one of 12. On a real rig the noise is the rig's, and a seed is a repeat.
"""

from __future__ import annotations

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction

from fpplab.acquisition.acquire import capture
from fpplab.core.conventions import Axis, Image
from fpplab.devices.rig import Rig
from fpplab.optimisation.candidate import Fringes
from fpplab.patterns.plan import FringeSet, Plan
from fpplab.simulation.seeded import Seeded

KEEP_BYTES = 3 << 28


@dataclass(frozen=True)
class MeasuringSetup:
    """What the camera looks at, how long, and where the projector stands; None is as it stands."""

    item: str
    exposure_s: float
    stage_mm: float | None = None
    convergence_deg: float | None = None


@dataclass(frozen=True)
class _Key:
    """What sets share images by. place: in the plan, where the noise follows from it, else 0."""

    view: MeasuringSetup
    axis: Axis
    stripes: float
    seed: int
    place: int


class FringeSetCache:
    """The frames of fringe sets on an open rig, acquired when they are asked for first.

    like: everything about a plan but its fringes and exposure. stand: brings the rig to a view before
    anything of it is acquired. keep_bytes: of frames; the longest unused sets are forgotten.
    """

    def __init__(
        self, rig: Rig, like: Plan, stand: Callable[[MeasuringSetup], None], keep_bytes: int = KEEP_BYTES
    ) -> None:
        self._rig, self._like, self._stand, self._limit = rig, like, stand, keep_bytes
        self._seeded = rig.simulation if isinstance(rig.simulation, Seeded) else None
        self._kept: OrderedDict[_Key, dict[int, list[Image]]] = OrderedDict()
        self.acquired = 0
        """Images taken since the beginning."""

    def frames(self, view: MeasuringSetup, fringes: Sequence[Fringes], seed: int) -> list[Image]:
        """The images of these sets in their order, raw. Raises `DeviceError`, `ConfigError`."""
        keys = [self._key(view, one, place, seed) for place, one in enumerate(fringes)]
        lacking = [i for i, key in enumerate(keys) if self._found(key, fringes[i].steps) is None]
        if lacking:
            self._stand(view)
            self._acquire(view, [fringes[i] for i in lacking], [keys[i] for i in lacking])
        sets = [self._found(key, one.steps) for key, one in zip(keys, fringes, strict=True)]
        self._forget_beyond(keys)
        return [frame for frames in sets if frames is not None for frame in frames]

    def _key(self, view: MeasuringSetup, fringes: Fringes, place: int, seed: int) -> _Key:
        return _Key(view, fringes.axis, fringes.stripes, seed, place if self._seeded else 0)

    def _found(self, key: _Key, steps: int) -> list[Image] | None:
        """From the set itself, or else from the smallest that holds it."""
        kept = self._kept.get(key, {})
        holding = min((count for count in kept if count % steps == 0), default=None)
        return None if holding is None else kept[holding][:: holding // steps]

    def _acquire(self, view: MeasuringSetup, fringes: list[Fringes], keys: list[_Key]) -> None:
        sets = tuple(FringeSet(**asdict(one)) for one in fringes)
        if self._seeded is not None:
            self._seeded.draw(
                number for key, one in zip(keys, fringes, strict=True) for number in draws(key, one.steps)
            )
        plan = self._like.model_copy(update={"fringes": sets, "exposure_s": view.exposure_s})
        frames = iter(capture(self._rig, plan))
        for key, one in zip(keys, fringes, strict=True):
            self._kept.setdefault(key, {})[one.steps] = [next(frames) for _ in range(one.steps)]
        self.acquired += plan.images

    def _forget_beyond(self, used: Iterable[_Key]) -> None:
        for key in used:
            self._kept.move_to_end(key)
        held = sum(_bytes(sets) for sets in self._kept.values())
        while held > self._limit and len(self._kept) > 1:
            held -= _bytes(self._kept.popitem(last=False)[1])


def _bytes(sets: dict[int, list[Image]]) -> int:
    return sum(frame.nbytes for frames in sets.values() for frame in frames)


def draws(key: _Key, steps: int) -> list[int]:
    """What the noise of each image of a set follows from: neither stripes nor how many steps there are."""
    return [_number(key.seed, key.view.item, key.axis, key.place, Fraction(n, steps)) for n in range(steps)]


def _number(*parts: object) -> int:
    digest = hashlib.blake2b("/".join(map(str, parts)).encode(), digest_size=7)
    return int.from_bytes(digest.digest(), "big")
