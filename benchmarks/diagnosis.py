"""Faults named by their own frames: by formulas, at strengths and seeds that set no limit.

Limits were chosen on seeds 100 to 112 and on the captures of a real rig; these are judged on others.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from benchmarks import Result, above, below
from fpplab.acquisition.rig_check import check_rig
from fpplab.cli import console
from fpplab.diagnosis import Diagnosis, Finding, Verdict, diagnose_scan
from fpplab.phase import Decoded, decode
from fpplab.reconstruction.points import points_of
from tests.support.faulty_bench import FAULTS, FAULTS_IN_TIME, PLANS, Bench, faulty, healthy
from tests.support.faulty_rig import formula_rig

SEEDS = range(300, 310)
"""Of faults; each draws a bench and a strength."""
HEALTHY = range(300, 320)
"""Of benches without fault."""
PAIRS = (
    ("ambient", "projector_focus"),
    ("projector_focus", "flicker"),
    ("saturated", "small_angle"),
    ("bands", "projector_focus"),
    ("underexposed", "projector_focus"),
    ("harmonics", "ambient"),
    ("interreflection", "flicker"),
    ("wrong_resolution", "ambient"),
)
"""Faults that are put into one bench together."""
PAIR_SEEDS = range(330, 333)
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
MOST_STEPS = 8


def run() -> list[Result]:
    """Measure; half an hour on two cores.

    Returns
    -------
    list of Result
        Shares named, and how near advice comes to the best noise.
    """
    found = [(cause, scanned(faulty(cause, seed))) for cause in FAULTS for seed in SEEDS]
    places = {cause: [_place(d.findings, cause) for c, d in found if c == cause] for cause in FAULTS}
    places |= {cause: [_place(_checked(cause, seed), cause) for seed in SEEDS] for cause in FAULTS_IN_TIME}
    for cause, where in places.items():
        first, second = sum(p == 0 for p in where), sum(p <= 1 for p in where)
        console.say(f"{cause}: {first} of {len(where)} first, {second} among the first two")
    every = np.concatenate(list(places.values()))
    silent = sum(d.verdict is Verdict.GOOD for _, d in found)
    told = sum(len(scanned(healthy(seed)).findings) > 0 for seed in HEALTHY)
    both = [_both_named(pair, seed) for pair in PAIRS for seed in PAIR_SEEDS]
    advised = [follow(faulty(cause, 340 + k), healthy_as(cause, 340 + k)) for k, cause in enumerate(BAD_RIGS)]
    return [
        above("first", 100.0 * float((every == 0).mean()), "%", 95.0),
        above("among_first_two", 100.0 * float((every <= 1).mean()), "%", 100.0),
        below("faults_called_good", float(silent), "scans", 1e-9),
        below("healthy_with_finding", float(told), "scans", 1e-9),
        above("pairs_both_named", 100.0 * float(np.mean(both)), "%", 80.0),
        below("advice_worst_noise", max(ratio for ratio, _ in advised), "times the best", 1.1),
        below("advice_most_steps", float(max(steps for _, steps in advised)), "steps", MOST_STEPS),
    ]


def scanned(bench: Bench) -> Diagnosis:
    """Take a scan of a bench and judge it.

    Parameters
    ----------
    bench : Bench
        With or without faults.

    Returns
    -------
    Diagnosis
        What `fpplab scan` would say.
    """
    recording = bench.recording()
    decoded, cloud = decode(recording), None
    if decoded.valid.any():
        decoded, cloud = points_of(decoded, bench.calibration, recording.plan, recording.mean_image())
    return diagnose_scan(recording, decoded, cloud, bench.calibration)


def healthy_as(cause: str, seed: int) -> Bench:
    """Give the bench that a faulty one would be without its fault, well exposed.

    Parameters
    ----------
    cause : str
        The fault.
    seed : int
        Of both.

    Returns
    -------
    Bench
        Of the same board and plan.
    """
    bench = healthy(seed)
    good = replace(bench.parameters, paper=0.9, ink=0.05, white=1.0)
    return replace(bench, plan=faulty(cause, seed).plan, parameters=good)


def follow(bench: Bench, best: Bench) -> tuple[float, int]:
    """Apply the remedy of the first finding until there is none.

    Parameters
    ----------
    bench : Bench
        A badly set one.
    best : Bench
        The same without its fault, from which come the settings that a person reads off the devices.

    Returns
    -------
    ratio : float
        Error of the coordinate beside that of the best bench.
    steps : int
        How many remedies were applied.
    """
    for step in range(MOST_STEPS + 1):
        findings = scanned(bench).findings
        if not findings or step == MOST_STEPS:
            break
        bench = REMEDIES_APPLIED.get(findings[0].cause.value, _as_is)(bench, best)
        if findings[0].factor:
            white = bench.parameters.white * findings[0].factor
            bench = replace(bench, parameters=replace(bench.parameters, white=white))
    ratio = coordinate_error_px(bench) / coordinate_error_px(best)
    console.say(f"advice: {ratio:.2f} times the best noise after {step} steps")
    return ratio, step


def coordinate_error_px(bench: Bench) -> float:
    """Compute the error of the coordinate beside that of the same bench without noise or fault.

    Parameters
    ----------
    bench : Bench
        Any.

    Returns
    -------
    float
        1.48 times the median size, in projector px; infinite where less than half of the pixels are left.
    """
    axis = bench.plan.axes[0]
    true = _expected(bench).coordinate(axis)
    seen = decode(bench.recording()).coordinate(axis)
    both = np.isfinite(true) & np.isfinite(seen)
    if both.sum() < 0.5 * np.isfinite(true).sum():
        return float("inf")
    return 1.48 * float(np.median(np.abs(seen[both] - true[both])))


def _expected(bench: Bench) -> Decoded:
    """Coordinates without noise or fault, by a plan of many images."""
    quiet = replace(
        bench.parameters, full_well_e=1e9, read_noise_e=0.0, ambient=0.0, white=0.9, projector_blur=0.6,
        camera_focus_mm=None,
    )  # fmt: skip
    still = Bench(quiet, PLANS["twelve"] if bench.plan.axes[0] == "x" else PLANS["rows"], 12)
    return decode(still.recording())


def _as_is(bench: Bench, _: Bench) -> Bench:
    return bench


def _mended(*names: str) -> Callable[[Bench, Bench], Bench]:
    def mended(bench: Bench, best: Bench) -> Bench:
        return replace(bench, **{name: getattr(best, name) for name in names})

    return mended


def _set(name: str) -> Callable[[Bench, Bench], Bench]:
    def mended(bench: Bench, best: Bench) -> Bench:
        return replace(bench, parameters=replace(bench.parameters, **{name: getattr(best.parameters, name)}))

    return mended


REMEDIES_APPLIED = {
    "ambient": _set("ambient"),
    "projector_focus": _set("projector_blur"),
    "camera_focus": _set("camera_focus_mm"),
    "flicker": _mended("flicker"),
    "bands": _mended("bands"),
    "vibration": _mended("vibration_mm"),
    "harmonics": _mended("third"),
    "wrong_resolution": _mended("scale"),
    "interreflection": _mended("bounce"),
}
"""What a person does who knows of a bench only what is said of its first finding."""


def _place(findings: Sequence[Finding], cause: str) -> int:
    """Where a cause is named, 0 first; far behind where it is not."""
    named = [finding.cause.value for finding in findings]
    return named.index(cause) if cause in named else 99


def _checked(cause: str, seed: int) -> tuple[Finding, ...]:
    """What `fpplab check` says of a fault that only further frames show."""
    bench = faulty(cause, seed)
    rig = formula_rig(cause, seed)
    return check_rig(rig, bench.plan, "card", lambda _: None, bench.calibration).findings


def _both_named(pair: tuple[str, str], seed: int) -> bool:
    """Put two faults into one bench: the second draws on what the first has done."""
    first, second = pair
    random = np.random.default_rng([seed, 9])
    bench = FAULTS[second](faulty(first, seed), random)
    named = {finding.cause.value for finding in scanned(bench).findings}
    return {first, second} <= named
