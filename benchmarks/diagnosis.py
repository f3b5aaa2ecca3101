"""Faults named by their own frames: simulated and emulated benches, at strengths and seeds that set no limit.

Limits were chosen on seeds 100 to 112, 500 to 559 and 700 to 770, and on the captures of a real rig; these
are judged on others. Strengths are drawn, like everything else of a bench, by its seed.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from benchmarks import Result, above, below
from fpplab.acquisition.rig_check import check_rig
from fpplab.characterisation.lens import breathes
from fpplab.cli import console
from fpplab.clouds import Cloud
from fpplab.core.errors import DataError
from fpplab.diagnosis import Diagnosis, Finding, Verdict, diagnose_scan
from fpplab.phase import Decoded, decode
from fpplab.reconstruction.points import points_of
from tests.characterisation.test_lens import breathing, fitted, scales
from tests.diagnosis import scenes
from tests.support.faulty_bench import FAULTS, FAULTS_IN_TIME, PLANS, Bench, faulty, healthy
from tests.support.faulty_devices import DEVICE_FAULTS, check_faulty_devices
from tests.support.faulty_rig import formula_rig

SEEDS = range(800, 810)
"""Of faults; each draws a bench and a strength."""
HEALTHY = range(800, 820)
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
    ("camera_focus", "ambient"),
    ("vibration", "response"),
)
"""Faults that are put into one bench together."""
PAIR_SEEDS = range(830, 833)
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
ADVICE_SEED, MOST_STEPS = 840, 8
USELESS_ERROR, USELESS_SHARE = 20.0, 0.1
"""Median error of the points beside that without the fault, from which on a cloud is of no use, and the share
of its points."""


@dataclass(frozen=True)
class Judged:
    """What was said of one bench.

    Attributes
    ----------
    cause : str
        Its fault; empty where it has none.
    named : tuple of str
        Causes found, the worst first.
    verdict : str
        Of the scan; empty where there was none.
    error : float
        Median error of the points beside that of the same bench without fault; 1 where it was not measured.
    share : float
        Points beside those without fault.
    """

    cause: str
    named: tuple[str, ...]
    verdict: str = ""
    error: float = 1.0
    share: float = 1.0

    @property
    def place(self) -> int:
        """Where the cause is named, 0 first; far behind where it is not."""
        return self.named.index(self.cause) if self.cause in self.named else 99

    @property
    def useless(self) -> bool:
        """Whether the points are of no use, by the true shape."""
        return self.error > USELESS_ERROR or self.share < USELESS_SHARE


def run() -> list[Result]:
    """Measure; some twenty minutes of one core.

    Returns
    -------
    list of Result
        Shares named, and how near advice comes to the best noise.
    """
    work: list[tuple[Callable[..., Judged], str, int]] = [
        *((of_scan, cause, seed) for cause in FAULTS for seed in SEEDS),
        *((of_scene, "undersampled", seed) for seed in SEEDS),
        *((of_check, cause, seed) for cause in FAULTS_IN_TIME for seed in SEEDS),
        *((of_devices, cause, seed) for cause in DEVICE_FAULTS for seed in SEEDS),
        *((of_lens, "lens_not_locked", seed) for seed in SEEDS),
        *((of_scan, "", seed) for seed in HEALTHY),
    ]
    found = _each(work, "Faults")
    pairs = _each([(of_pair, "+".join(pair), seed) for pair in PAIRS for seed in PAIR_SEEDS], "Pairs")
    advised = [
        follow(ill_set(cause, ADVICE_SEED + k), well_set(cause, ADVICE_SEED + k))
        for k, cause in enumerate(BAD_RIGS)
    ]
    faults = [one for one in found if one.cause]
    for cause in dict.fromkeys(one.cause for one in faults):
        tell([one for one in faults if one.cause == cause])
    places = np.array([one.place for one in faults])
    useless = [one for one in faults if one.useless]
    written = [one for one in useless if one.verdict and one.verdict != Verdict.USELESS]
    refused = [one for one in faults if one.verdict == Verdict.USELESS and not one.useless]
    console.say(f"{len(useless)} useless clouds; {len(refused)} others were refused as well")
    called_good = [one for one in faults if one.verdict == Verdict.GOOD]
    told = [one for one in found if not one.cause and one.named]
    both = [set(one.cause.split("+")) <= set(one.named) for one in pairs]
    return [
        above("first", 100.0 * float((places == 0).mean()), "%", 95.0),
        above("among_first_two", 100.0 * float((places <= 1).mean()), "%", 100.0),
        below("faults_called_good", float(len(called_good)), "scans", 1e-9),
        below("useless_written", float(len(written)), "scans", 1e-9),
        below("healthy_with_finding", float(len(told)), "scans", 1e-9),
        above("pairs_both_named", 100.0 * float(np.mean(both)), "%", 80.0),
        below("advice_worst_noise", max(ratio for ratio, _ in advised), "times the best", 1.1),
        below("advice_most_steps", float(max(steps for _, steps in advised)), "steps", MOST_STEPS),
    ]


def tell(judged: Sequence[Judged]) -> None:
    """Print how often a cause was named, and what was named in its place.

    Parameters
    ----------
    judged : sequence of Judged
        Benches of one cause.
    """
    first, second = (sum(one.place <= k for one in judged) for k in (0, 1))
    useless = sum(one.useless for one in judged)
    instead = [", ".join(one.named[:3]) or "nothing" for one in judged if one.place > 0]
    more = f" ({'; '.join(instead)})" if instead else ""
    count = len(judged)
    console.say(
        f"{judged[0].cause}: {first} of {count} first, {second} among the first two, {useless} useless{more}"
    )


def _each(work: Sequence[tuple[Callable[..., Judged], str, int]], what: str) -> list[Judged]:
    """Judge benches in processes of one thread each."""
    found = []
    with ProcessPoolExecutor(len(os.sched_getaffinity(0)), get_context("spawn"), _one_thread) as pool:
        waiting = [pool.submit(judge, cause, seed) for judge, cause, seed in work]
        with console.progress(what) as progress:
            for k, one in enumerate(waiting):
                found.append(one.result())
                progress((k + 1) / len(waiting))
    return found


def _one_thread() -> None:
    os.environ |= {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def of_scan(cause: str, seed: int) -> Judged:
    """Scan a bench and judge it, and measure the points by the true shape.

    Parameters
    ----------
    cause : str
        Its fault; empty for none.
    seed : int
        Of the bench and the fault's strength.

    Returns
    -------
    Judged
        With errors beside those of the same bench without fault.
    """
    bench = faulty(cause, seed) if cause else healthy(seed)
    diagnosis, cloud = scanned_points(bench)
    right = replace(healthy(seed), plan=bench.plan, parameters=replace(healthy(seed).parameters, paper=0.9))
    _, best = scanned_points(right) if cause else (None, cloud)
    error, share = float("inf"), 0.0
    if cloud is not None and best is not None and len(cloud):
        error = error_mm(bench, cloud) / error_mm(right if cause else bench, best)
        share = len(cloud) / len(best)
    return Judged(cause, _named(diagnosis.findings), diagnosis.verdict.value, error, share)


def of_pair(causes: str, seed: int) -> Judged:
    """Put two faults into one bench: the second draws on what the first has done.

    Parameters
    ----------
    causes : str
        Both, with a plus sign between them.
    seed : int
        Of the bench and the faults' strengths.

    Returns
    -------
    Judged
        Without errors.
    """
    first, second = causes.split("+")
    bench = FAULTS[second](faulty(first, seed), np.random.default_rng([seed, 9]))
    diagnosis = scanned(bench)
    return Judged(causes, _named(diagnosis.findings), diagnosis.verdict.value)


def of_scene(cause: str, seed: int) -> Judged:
    """Scan a part with fringes that are too fine for the camera.

    Parameters
    ----------
    cause : str
        The fault.
    seed : int
        Of the number of stripes and of the noise.

    Returns
    -------
    Judged
        Without errors.
    """
    stripes = int(np.random.default_rng([seed, 4]).integers(165, 200))
    scene = scenes.Bench(scenes.plan_of("x", (6, 6, 12), (1, 12, stripes)), seed=seed)
    recording = scene.recording()
    decoded, cloud = points_of(decode(recording), scene.rig(), recording.plan, recording.mean_image())
    diagnosis = diagnose_scan(recording, decoded, cloud, scene.rig())
    return Judged(cause, _named(diagnosis.findings), diagnosis.verdict.value)


def of_check(cause: str, seed: int) -> Judged:
    """Check a rig with a fault that only further frames show.

    Parameters
    ----------
    cause : str
        The fault.
    seed : int
        Of the bench and the fault's strength.

    Returns
    -------
    Judged
        Without verdict.
    """
    bench = faulty(cause, seed)
    found = check_rig(formula_rig(cause, seed), bench.plan, "card", lambda _: None, bench.calibration)
    return Judged(cause, _named(found.findings))


def of_devices(cause: str, seed: int) -> Judged:
    """Check a rig whose devices have a fault.

    Parameters
    ----------
    cause : str
        The fault.
    seed : int
        Of its strength.

    Returns
    -------
    Judged
        Without verdict.
    """
    return Judged(cause, _named(check_faulty_devices(cause, seed, _flash()).findings))


def of_lens(cause: str, seed: int) -> Judged:
    """Characterise a rig whose camera's lens was turned between poses.

    Parameters
    ----------
    cause : str
        The fault.
    seed : int
        Of the poses and of the scale's scatter, 0.03 to 0.1 %.

    Returns
    -------
    Judged
        Without verdict.
    """
    scatter = float(np.random.default_rng([seed, 6]).uniform(3e-4, 1e-3))
    return Judged(cause, (cause,) if breathes(*scales(fitted(breathing(scatter, seed)))) else ())


@cache
def _flash() -> Path:
    """Folder of a process for the flash of the emulated projector."""
    return Path(mkdtemp(prefix="fpplab-diagnosis-"))


def _named(findings: Sequence[Finding]) -> tuple[str, ...]:
    return tuple(finding.cause.value for finding in findings)


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
    return scanned_points(bench)[0]


def scanned_points(bench: Bench) -> tuple[Diagnosis, Cloud | None]:
    """Take a scan of a bench and judge it.

    Parameters
    ----------
    bench : Bench
        With or without faults.

    Returns
    -------
    diagnosis : Diagnosis
        What `fpplab scan` would say.
    cloud : Cloud or None
        Its points; None where there are none.
    """
    recording = bench.recording()
    decoded, cloud = decode(recording), None
    if decoded.valid.any():
        with suppress(DataError):  # no point is left: the frames say why
            decoded, cloud = points_of(decoded, bench.calibration, recording.plan, recording.mean_image())
    return diagnose_scan(recording, decoded, cloud, bench.calibration), cloud


def error_mm(bench: Bench, cloud: Cloud) -> float:
    """Compute how far points are off the board, where the true rays of their pixels meet it.

    Parameters
    ----------
    bench : Bench
        Whose board it is.
    cloud : Cloud
        Its points, at least one, with their pixels.

    Returns
    -------
    float
        Median distance in mm.
    """
    camera, board = bench.parameters.calibration.camera, bench.parameters.poses[0]
    assert cloud.pixels is not None
    slopes = camera.normalise(cloud.pixels.astype(np.float64))
    rays = np.concatenate([slopes, np.ones((len(slopes), 1))], axis=1)
    normal = board.rotation[:, 2]
    true = rays * ((normal @ board.translation) / (rays @ normal))[:, None]
    return float(np.median(np.linalg.norm(cloud.points - true, axis=1)))


def well_set(cause: str, seed: int) -> Bench:
    """Give a bench without fault, well exposed, with the plan that a fault is seen with.

    Parameters
    ----------
    cause : str
        The fault.
    seed : int
        Of the bench.

    Returns
    -------
    Bench
        A bright board.
    """
    bench = healthy(seed)
    good = replace(bench.parameters, paper=0.9, ink=0.05, white=1.0)
    return replace(bench, plan=faulty(cause, seed).plan, parameters=good)


def ill_set(cause: str, seed: int) -> Bench:
    """Give the same bench with one thing set badly.

    Parameters
    ----------
    cause : str
        The fault.
    seed : int
        Of the bench and the fault's strength.

    Returns
    -------
    Bench
        As `well_set` gives it, but for the fault.
    """
    return FAULTS[cause](well_set(cause, seed), np.random.default_rng([seed, 3]))


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
