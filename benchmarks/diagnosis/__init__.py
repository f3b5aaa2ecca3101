"""Faults named by their own frames: simulated and emulated benches, at strengths and seeds that set no limit.

    python -m benchmarks.diagnosis [--seed FIRST] [--count N] [--causes A,B,…] [--record FILE]

Limits were chosen on seeds 100 to 112, 200 to 399, 500 to 559, 700 to 770, 1000 to 1049, 1100 to 1103, 1200
to 1249 and 1309, and on captures of a real rig; these are judged on others. Strengths are drawn, like all
else of a bench, by its seed. Methods are developed with another first seed than that which judges them.
"""

import logging
import os
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from itertools import cycle
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar
from unittest.mock import patch

import numpy as np

from benchmarks import Result, above, below
from benchmarks.diagnosis.advice import MOST_STEPS, Followed, follow
from benchmarks.diagnosis.judging import (
    Judged,
    of_check,
    of_devices,
    of_lens,
    of_pair,
    of_rig,
    of_scan,
    of_scene,
)
from benchmarks.diagnosis.record import Record
from fpplab.cli import console
from fpplab.core.errors import ConfigError
from fpplab.devices.backends import allow_backends
from fpplab.diagnosis import Verdict
from tests.support.faulty_bench import FAULTS, FAULTS_IN_TIME
from tests.support.faulty_devices import DEVICE_FAULTS

JUDGING_SEED = 1400
"""The first seed of those that nothing was developed with."""
COUNT = 10
"""Benches of each fault."""
FORMULA_RIGS = 14
"""Benches by formulas without fault; the simulated rigs follow."""
SIMULATED_RIGS = ("rig_demo", "rig_workshop", "rig_matched")
"""Rigs without fault that come with fpplab; each is scanned with two seeds."""
PAIRS_AFTER, PAIR_COUNT = 30, 3
"""Seeds of pairs of faults, counted from the first seed."""
ADVICE_AFTER = 40
"""Seed of the first badly set rig, counted from the first seed."""
PAIRS = (
    ("ambient", "projector_focus"),
    ("projector_focus", "flicker"),
    ("saturated", "small_angle"),
    ("bands", "projector_focus"),
    ("underexposed", "projector_focus"),
    ("harmonics", "ambient"),
    ("interreflection", "flicker"),
    ("wrong_resolution", "ambient"),
    ("camera_focus", "ambient"),
    ("vibration", "response"),
)
"""Faults that are put into one bench together."""
BAD_RIGS = (
    "ambient",
    "projector_focus",
    "underexposed",
    "saturated",
    "flicker",
    "bands",
    "camera_focus",
    "vibration",
    "harmonics",
    "wrong_resolution",
)
"""Faults of the benches that advice is followed on."""
JUDGES: dict[str, Callable[[str, int], Judged]] = {
    **dict.fromkeys(FAULTS, of_scan),
    "undersampled": of_scene,
    **dict.fromkeys(FAULTS_IN_TIME, of_check),
    **{f"{cause} (device)" if cause in FAULTS else cause: of_devices for cause in DEVICE_FAULTS},
    "lens_not_locked": of_lens,
}
"""Faults, and where each is looked for."""

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
"""Environment of the processes that judge benches side by side."""

log = logging.getLogger("benchmarks")
T = TypeVar("T", Judged, Followed)
Work = tuple[Callable[[str, int], T], str, int]


@dataclass(frozen=True)
class Selection:
    """What is measured."""

    seed: int = JUDGING_SEED  # the first; all others are counted from it
    count: int = COUNT  # benches of each fault
    causes: tuple[str, ...] = ()  # the faults
    record: Path | None = None  # where each outcome is written as it comes


def run() -> list[Result]:
    """Measure everything; some twenty minutes on two cores."""
    return measure(Selection())


def measure(part: Selection) -> list[Result]:
    """Measure a part."""
    unknown = [cause for cause in part.causes if cause not in JUDGES]
    if unknown:
        raise ConfigError(f"--causes: '{unknown[0]}' is none of {', '.join(JUDGES)}")
    # The rigs by formulas are backends of the tests.
    allow_backends(["tests"])
    cores = len(os.sched_getaffinity(0))
    record = Record(part.record) if part.record else None
    with patch.dict(os.environ, ONE_THREAD), ProcessPoolExecutor(cores, get_context("spawn")) as pool:
        each = _Judging(pool, record).each
        results = _of_faults(each(_faults(part), "Faults"))
        if part.causes:
            return results
        return [
            *results,
            _of_healthy(each(_healthy(part), "Benches without fault")),
            _of_pairs(each(_pairs(part), "Pairs")),
            *_of_advice(each(_advised(part), "Advice")),
        ]


def _faults(part: Selection) -> list[Work[Judged]]:
    seeds = range(part.seed, part.seed + part.count)
    causes = part.causes or tuple(JUDGES)
    # Seed by seed, since benches of one seed are compared with the same bench without fault.
    return [(JUDGES[cause], cause.split()[0], k) for k in seeds for cause in causes]


def _healthy(part: Selection) -> list[Work[Judged]]:
    formulas: list[Work[Judged]] = [(of_scan, "", part.seed + k) for k in range(FORMULA_RIGS)]
    names = zip(cycle(SIMULATED_RIGS), range(2 * len(SIMULATED_RIGS)), strict=False)
    return [*formulas, *((of_rig, name, part.seed + FORMULA_RIGS + k) for name, k in names)]


def _pairs(part: Selection) -> list[Work[Judged]]:
    seeds = range(part.seed + PAIRS_AFTER, part.seed + PAIRS_AFTER + PAIR_COUNT)
    return [(of_pair, "+".join(pair), seed) for pair in PAIRS for seed in seeds]


def _advised(part: Selection) -> list[Work[Followed]]:
    return [(follow, cause, part.seed + ADVICE_AFTER + k) for k, cause in enumerate(BAD_RIGS)]


@dataclass(frozen=True)
class _Judging:
    """Processes of one thread each that judge, and where their outcomes are kept."""

    pool: ProcessPoolExecutor
    record: Record | None

    def each(self, work: Sequence[Work[T]], what: str) -> list[T]:
        """Judge benches, but for those that the record knows."""
        found = {k: one for k, job in enumerate(work) if (one := self._known(job)) is not None}
        waiting = {
            self.pool.submit(judge, cause, seed): k
            for k, (judge, cause, seed) in enumerate(work)
            if k not in found
        }
        try:
            with console.progress(what) as progress:
                for done in as_completed(waiting):
                    k = waiting[done]
                    found[k] = done.result()
                    log.info("%s", found[k])
                    if self.record:
                        self.record.add(*work[k], found[k])
                    progress(len(found) / len(work))
        except BaseException:
            self.pool.shutdown(wait=False, cancel_futures=True)
            raise
        return [found[k] for k in range(len(work))]

    def _known(self, job: Work[T]) -> T | None:
        return self.record.known(*job) if self.record else None


def _of_faults(faults: Sequence[Judged]) -> list[Result]:
    for cause in dict.fromkeys(one.cause for one in faults):
        tell([one for one in faults if one.cause == cause])
    places = np.array([one.place for one in faults])
    verdicts = Counter((one.verdict, one.useless) for one in faults if one.verdict)
    written = sum(n for (verdict, useless), n in verdicts.items() if useless and verdict != Verdict.USELESS)
    useless = sum(n for (_, useless), n in verdicts.items() if useless)
    console.log_status(
        f"{useless} useless clouds; {verdicts[Verdict.USELESS, False]} others were refused as well"
    )
    good = sum(n for (verdict, _), n in verdicts.items() if verdict == Verdict.GOOD)
    return [
        above("first", 100.0 * float((places == 0).mean()), "%", 95.0),
        above("among_first_two", 100.0 * float((places <= 1).mean()), "%", 100.0),
        below("faults_called_good", float(good), "scans", 1e-9),
        below("useless_written", float(written), "scans", 1e-9),
    ]


def _of_healthy(healthy: Sequence[Judged]) -> Result:
    told = [one for one in healthy if one.named or one.verdict != Verdict.GOOD]
    for one in told:
        console.log_status(
            f"without fault, seed {one.seed}: {one.verdict}, {', '.join(one.named) or 'no finding'}"
        )
    return below("healthy_with_finding", float(len(told)), "scans", 1e-9)


def _of_pairs(pairs: Sequence[Judged]) -> Result:
    both = [set(one.cause.split("+")) <= set(one.named) for one in pairs]
    for one, named in zip(pairs, both, strict=True):
        if not named:
            console.log_status(f"{one.cause}, seed {one.seed}: {', '.join(one.named) or 'nothing'}")
    return above("pairs_both_named", 100.0 * float(np.mean(both)), "%", 80.0)


def _of_advice(advised: Sequence[Followed]) -> list[Result]:
    for one in advised:
        console.log_status(
            f"advice, {one.cause}: {one.ratio:.2f} times the best noise after {one.steps} steps"
        )
    return [
        below("advice_worst_noise", max(one.ratio for one in advised), "times the best", 1.1),
        below("advice_most_steps", float(max(one.steps for one in advised)), "steps", MOST_STEPS),
    ]


def tell(judged: Sequence[Judged]) -> None:
    """Print how often a cause was named, and what was named in its place."""
    first, second = (sum(one.place <= k for one in judged) for k in (0, 1))
    useless = sum(one.useless for one in judged)
    instead = [f"{one.seed}: {', '.join(one.named[:3]) or 'nothing'}" for one in judged if one.place > 0]
    more = f" ({'; '.join(instead)})" if instead else ""
    count = len(judged)
    console.log_status(
        f"{judged[0].cause}: {first} of {count} first, {second} among the first two, {useless} useless{more}"
    )
