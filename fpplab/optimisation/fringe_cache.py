"""A cache of fringe sets, each acquired once, from which the measurements of plans are put together.

A set of N steps is also taken from the images of one with a multiple of N. On a simulation candidates are
compared with common random numbers: the noise of an image depends on the seed, the item, the position of its
set in the plan and its phase shift alone, so not on the order of measurements or the process.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction

from fpplab.acquisition.acquire import capture
from fpplab.core.conventions import Axis, Image
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Seeded
from fpplab.optimisation.candidate import Fringes
from fpplab.patterns.fringe_sets import Sinusoid
from fpplab.patterns.plan import Plan


@dataclass(frozen=True)
class MeasuringSetup:
    """Everything but the fringes that an image depends on."""

    item: str  # item of the fixture that the camera looks at
    exposure_s: float  # exposure of every image in seconds
    stage_mm: float | None = None  # position of the stage in mm; None leaves it
    convergence_deg: float | None = None  # rotation of the projector towards the camera in degrees
    taken: int = 0  # how often every image was taken before, at other exposures


@dataclass(frozen=True)
class _Key:
    """What fringe sets share images by. place: position in the plan if the noise depends on it, else 0."""

    setup: MeasuringSetup
    axis: Axis
    stripes: float
    pattern_bits: int | None
    seed: int
    place: int


class FringeSetCache:
    """The frames of fringe sets on an open rig, acquired when they are first asked for."""

    def __init__(
        self,
        rig: Rig,
        template: Plan,
        arrange: Callable[[MeasuringSetup], None],
        keep_bytes: int = 3 << 28,  # chosen: 0.8 GB of frames
    ) -> None:
        self._rig, self._template, self._arrange, self._limit = rig, template, arrange, keep_bytes
        self._seeded = rig.simulation if isinstance(rig.simulation, Seeded) else None
        self._kept: OrderedDict[_Key, dict[int, list[Image]]] = OrderedDict()
        self.acquired = 0
        """Images taken since the beginning."""

    def frames(self, setup: MeasuringSetup, fringes: Sequence[Fringes], seed: int) -> list[Image]:
        # returns (height, width)
        keys = [self._key(setup, fringe_set, place, seed) for place, fringe_set in enumerate(fringes)]
        missing = [i for i, key in enumerate(keys) if self._cached_frames(key, fringes[i].steps) is None]
        if missing:
            self._arrange(setup)
            self._acquire(setup, [fringes[i] for i in missing], [keys[i] for i in missing])
        sets = [
            self._cached_frames(key, fringe_set.steps) for key, fringe_set in zip(keys, fringes, strict=True)
        ]
        self._evict_unused(keys)
        return [frame for frames in sets if frames is not None for frame in frames]

    def _key(self, setup: MeasuringSetup, fringes: Fringes, place: int, seed: int) -> _Key:
        return _Key(
            setup, fringes.axis, fringes.stripes, fringes.pattern_bits, seed, place if self._seeded else 0
        )

    def _cached_frames(self, key: _Key, steps: int) -> list[Image] | None:
        """Frames of a set from the set itself, or else from the smallest that contains it."""
        kept = self._kept.get(key, {})
        holding = min((count for count in kept if count % steps == 0), default=None)
        return None if holding is None else kept[holding][:: holding // steps]

    def _acquire(self, setup: MeasuringSetup, fringes: list[Fringes], keys: list[_Key]) -> None:
        sets = tuple(Sinusoid(**asdict(fringe_set)) for fringe_set in fringes)
        if self._seeded is not None:
            self._seeded.draw(
                number
                for key, fringe_set in zip(keys, fringes, strict=True)
                for number in noise_numbers(key, fringe_set.steps)
            )
        plan = self._template.model_copy(
            update={"fringes": sets, "exposure_s": setup.exposure_s, "exposures_s": None}
        )
        frames = iter(capture(self._rig, plan))
        for key, fringe_set in zip(keys, fringes, strict=True):
            self._kept.setdefault(key, {})[fringe_set.steps] = [next(frames) for _ in range(fringe_set.steps)]
        self.acquired += plan.images

    def _evict_unused(self, used: Iterable[_Key]) -> None:
        for key in used:
            self._kept.move_to_end(key)
        held = sum(_frame_bytes(sets) for sets in self._kept.values())
        while held > self._limit and len(self._kept) > 1:
            held -= _frame_bytes(self._kept.popitem(last=False)[1])


def _frame_bytes(sets: dict[int, list[Image]]) -> int:
    return sum(frame.nbytes for frames in sets.values() for frame in frames)


def noise_numbers(key: _Key, steps: int) -> list[int]:
    # It depends neither on the stripe count nor on the number of steps, so that similar candidates have equal
    # noise.
    again = (key.setup.taken,) if key.setup.taken else ()
    parts = key.seed, key.setup.item, key.axis, key.place
    return [_hash_number(*parts, Fraction(n, steps), *again) for n in range(steps)]


def _hash_number(*parts: object) -> int:
    digest = hashlib.blake2b("/".join(map(str, parts)).encode(), digest_size=7)
    return int.from_bytes(digest.digest(), "big")
