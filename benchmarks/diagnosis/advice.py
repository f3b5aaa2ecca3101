"""A person who follows the advice alone: the remedy of the first finding, until there is none."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.diagnosis.judging import scanned
from fpplab.phase import Decoded, decode
from tests.support.faulty_bench import FAULTS, PLANS, Bench, faulty, healthy

MOST_STEPS = 8
"""Remedies that may be needed."""


@dataclass(frozen=True)
class Followed:
    """Where advice has led."""

    cause: str  # what was set badly at first
    ratio: float  # error of the coordinate beside that of the best bench
    steps: int  # how many remedies were applied


def follow(cause: str, seed: int) -> Followed:
    """Apply the remedy of the first finding on a badly set bench until there is none."""
    bench, best = ill_set(cause, seed), well_set(cause, seed)
    for step in range(MOST_STEPS + 1):
        findings = scanned(bench).findings
        if not findings or step == MOST_STEPS:
            break
        bench = REMEDIES_APPLIED.get(findings[0].cause.key, _as_is)(bench, best)
        if findings[0].factor:
            white = bench.parameters.white * findings[0].factor
            bench = replace(bench, parameters=replace(bench.parameters, white=white))
    return Followed(cause, coordinate_error_px(bench) / coordinate_error_px(best), step)


def well_set(cause: str, seed: int) -> Bench:
    """Give a bench without fault, well exposed, with the plan that a fault is seen with."""
    bench = healthy(seed)
    good = replace(bench.parameters, paper=0.9, ink=0.05, white=1.0)
    return replace(bench, plan=faulty(cause, seed).plan, parameters=good)


def ill_set(cause: str, seed: int) -> Bench:
    """Give the same bench with one thing set badly."""
    return FAULTS[cause](well_set(cause, seed), np.random.default_rng([seed, 3]))


def coordinate_error_px(bench: Bench) -> float:
    """Compute the error of the coordinate beside that of the same bench without noise or fault."""
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
