"""What is said of one bench with a fault, or without, and how far off its points are."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.characterisation.lens import has_focus_breathing
from fpplab.clouds import Cloud
from fpplab.core import config
from fpplab.core.errors import CalibrationError, DataError
from fpplab.core.files import write_text
from fpplab.core.strict_yaml import load_yaml
from fpplab.devices.rig import Rig, RigFile
from fpplab.diagnosis import Diagnosis, Finding, diagnose_scan
from fpplab.patterns.plan import Plan
from fpplab.phase import decode
from fpplab.pipeline.taking import take_or_resume_session
from fpplab.reconstruction.points import points_of
from fpplab.setup.rig_check.check import check_rig
from sim.world import World
from tests.diagnosis import scenes
from tests.support.breathing_lens import breathing, fitted, scales
from tests.support.faulty_bench import FAULTS, Bench, faulty, healthy
from tests.support.faulty_devices import check_faulty_devices
from tests.support.faulty_rig import formula_rig

USELESS_ERROR, USELESS_SHARE = 20.0, 0.1
"""Median error of the points beside that without the fault, from which on a cloud is of no use, and the share
of its points beside those that both devices see."""

ITEMS = ("pyramid", "steps")
"""What the simulated rigs scan in turn."""


@dataclass(frozen=True)
class Judged:
    """What was said of one bench."""

    cause: str  # its fault; empty where it has none
    seed: int  # of the bench
    named: tuple[str, ...]  # causes found, the worst first
    verdict: str = ""  # of the scan; empty where there was none
    error: float = 1.0  # median error of the points beside that of the same bench without fault
    share: float = 1.0  # points beside those without fault

    @property
    def place(self) -> int:
        """Where the cause is named, 0 first; far behind where it is not."""
        return self.named.index(self.cause) if self.cause in self.named else 99

    @property
    def useless(self) -> bool:
        """Whether the points are of no use, by the true shape."""
        return self.error > USELESS_ERROR or self.share < USELESS_SHARE


def of_scan(cause: str, seed: int) -> Judged:
    """Scan a bench and judge it, and measure the points by the true shape."""
    bench = faulty(cause, seed) if cause else healthy(seed)
    diagnosis, cloud = scanned_points(bench)
    named = _named(diagnosis.findings)
    if not cause:
        return Judged(cause, seed, named, diagnosis.verdict.value)
    error, share = float("inf"), 0.0
    if cloud is not None and len(cloud):
        best_mm, most = _without_fault(seed, bench.plan, bench.window)
        error, share = error_mm(bench, cloud) / best_mm, len(cloud) / most
    return Judged(cause, seed, named, diagnosis.verdict.value, error, share)


@lru_cache(maxsize=64)
def _without_fault(seed: int, plan: Plan, window: float) -> tuple[float, int]:
    """Median error in mm, and number, of the points of a bench without fault."""
    bench = healthy(seed)
    bright = replace(bench.parameters, paper=0.9)
    right = replace(bench, plan=plan, window=window, parameters=bright)
    _, cloud = scanned_points(right)
    assert cloud is not None
    return error_mm(right, cloud), len(cloud)


def of_rig(name: str, seed: int) -> Judged:
    """Scan a part on a simulated rig without fault, and judge it."""
    with TemporaryDirectory() as folder:
        rig, known = seeded_rig(name, seed, Path(folder))
        with rig:
            session = take_or_resume_session(
                rig, Plan.load("plan_paper"), Path(folder) / "scan", (ITEMS[seed % len(ITEMS)], 0)
            )
        recording = session.recording()
        decoded, cloud = points_of(decode(recording), known, recording.plan, recording.mean_image())
        diagnosis = diagnose_scan(recording, decoded, cloud, known)
    return Judged("", seed, _named(diagnosis.findings), diagnosis.verdict.value)


def seeded_rig(name: str, seed: int, folder: Path) -> tuple[Rig, Calibration]:
    """Load a simulated rig whose noise is another."""
    rig = load_yaml(config.find_config(name, "rig").read_text())
    world = load_yaml(config.find_config(rig["bench"]["world"], "world").read_text())
    path = folder / "world.yaml"
    write_text(path, config.to_yaml(world | {"seed": seed}))
    rig["bench"] |= {"world": str(path)}
    there = World.load(path)
    known = Calibration(there.camera_model(), there.projector_model(), there.T_projector_camera(), {})
    return Rig(config.validate(rig, RigFile, name), folder, name), known


def of_pair(causes: str, seed: int) -> Judged:
    """Put two faults into one bench: the second draws on what the first has done."""
    first, second = causes.split("+")
    bench = FAULTS[second](faulty(first, seed), np.random.default_rng([seed, 9]))
    diagnosis = scanned(bench)
    return Judged(causes, seed, _named(diagnosis.findings), diagnosis.verdict.value)


def of_scene(cause: str, seed: int) -> Judged:
    """Scan a part with fringes that are too fine for the camera."""
    stripes = int(np.random.default_rng([seed, 4]).integers(165, 200))
    scene = scenes.Bench(scenes.plan_of("x", (6, 6, 12), (1, 12, stripes)), seed=seed)
    recording = scene.recording()
    decoded, cloud = points_of(decode(recording), scene.rig(), recording.plan, recording.mean_image())
    diagnosis = diagnose_scan(recording, decoded, cloud, scene.rig())
    return Judged(cause, seed, _named(diagnosis.findings), diagnosis.verdict.value)


def of_check(cause: str, seed: int) -> Judged:
    """Check a rig with a fault that only further frames show."""
    bench = faulty(cause, seed)
    found = check_rig(formula_rig(cause, seed), bench.plan, "card", lambda _: None, bench.calibration)
    return Judged(cause, seed, _named(found.findings))


def of_devices(cause: str, seed: int) -> Judged:
    """Check a rig whose devices have a fault."""
    return Judged(cause, seed, _named(check_faulty_devices(cause, seed, _flash()).findings))


def of_lens(cause: str, seed: int) -> Judged:
    """Characterise a rig whose camera's lens was turned between poses."""
    scatter = float(np.random.default_rng([seed, 6]).uniform(3e-4, 1e-3))
    try:
        named = has_focus_breathing(*scales(fitted(breathing(scatter, seed))))
    except CalibrationError:  # its message names no lens
        named = False
    return Judged(cause, seed, (cause,) if named else ())


@cache
def _flash() -> Path:
    """Folder of a process for the flash of the emulated projector."""
    return Path(mkdtemp(prefix="fpplab-diagnosis-"))


def _named(findings: Sequence[Finding]) -> tuple[str, ...]:
    return tuple(finding.cause.key for finding in findings)


def scanned(bench: Bench) -> Diagnosis:
    """Take a scan of a bench and judge it."""
    return scanned_points(bench)[0]


def scanned_points(bench: Bench) -> tuple[Diagnosis, Cloud | None]:
    """Take a scan of a bench and judge it."""
    recording = bench.recording()
    decoded, cloud = decode(recording), None
    if decoded.valid.any():
        with suppress(DataError):  # no point is left: the frames say why
            decoded, cloud = points_of(decoded, bench.calibration, recording.plan, recording.mean_image())
    return diagnose_scan(recording, decoded, cloud, bench.calibration), cloud


def error_mm(bench: Bench, cloud: Cloud) -> float:
    """Compute how far points are off the board, where the true rays of their pixels meet it."""
    camera, board = bench.parameters.calibration.camera, bench.parameters.poses[0]
    assert cloud.pixels is not None
    slopes = camera.normalise(cloud.pixels.astype(np.float64))
    rays = np.concatenate([slopes, np.ones((len(slopes), 1))], axis=1)
    normal = board.rotation[:, 2]
    true = rays * ((normal @ board.translation) / (rays @ normal))[:, None]
    return float(np.median(np.linalg.norm(cloud.points - true, axis=1)))
