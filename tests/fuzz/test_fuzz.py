"""Seeds, kept inputs and random changes of both through every target, for a second or two each."""

import random
import resource
import time
from pathlib import Path

import pytest

from fpplab.core.errors import FppError
from tests.fuzz import seeds
from tests.fuzz.targets import TARGETS

SECONDS, MOST_SEEDS = 1.0, 12
LONGEST_S, MOST_BYTES = 5.0, 2_000_000_000


def changed(data: bytes, others: list[bytes], chance: random.Random) -> bytes:
    """With some bytes replaced, removed, doubled, or taken from another input."""
    changes = bytearray(data)
    for _ in range(chance.choice((1, 1, 2, 4, 8))):
        at = chance.randrange(len(changes) + 1)
        length = min(chance.choice((1, 1, 2, 4, 8, 32)), len(changes) - at)
        other = chance.choice(others)
        start = chance.randrange(len(other) + 1)
        changes[at : at + length] = chance.choice(
            (
                chance.randbytes(length),
                b"",
                bytes(changes[at : at + length] * 2),
                other[start : start + 16],
                bytes([chance.choice((0, 255, 127, 128))]) * length,
                b"[" * 200,
            )
        )
    return bytes(changes)


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("name", TARGETS)
def test_only_typed_errors(name: str, tmp_path: Path) -> None:
    target, chance = TARGETS[name], random.Random(1)
    every = target.seeds()
    first = [*chance.sample(every, min(MOST_SEEDS, len(every))), *seeds.kept(name)]
    until, done = time.monotonic() + SECONDS, 0
    while done < len(first) or time.monotonic() < until:
        data = first[done] if done < len(first) else changed(chance.choice(first), first, chance)
        began = time.process_time()
        target(data, tmp_path)
        assert time.process_time() - began < LONGEST_S, data[:200]
        done += 1
    assert done >= len(first) > 0
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 < 4 * MOST_BYTES


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("name", TARGETS)
def test_what_must_load_loads(name: str, tmp_path: Path) -> None:
    """A reader that refuses what it is made for would be fuzzed in vain."""
    must = TARGETS[name].loads()
    assert must
    for data in random.Random(1).sample(must, min(MOST_SEEDS, len(must))):
        TARGETS[name].read(data, tmp_path)


def test_a_seed_that_is_refused_is_noticed(tmp_path: Path) -> None:
    with pytest.raises(FppError):
        TARGETS["image"].read(b"BM no picture", tmp_path)


def test_a_target_that_raises_is_noticed(tmp_path: Path) -> None:
    target = TARGETS["yaml"]
    with pytest.raises(ZeroDivisionError):
        type(target)(lambda data, folder: 1 // 0, list, ())(b"", tmp_path)
