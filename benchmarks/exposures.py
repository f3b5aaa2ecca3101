"""Several exposures: black rubber beside polished metal, the uncertainty stated, and the choice of exposures.

Frames are made by the formulas of fringes and of a sensor with shot noise, read-out noise, black level and
8 bits. Matt parts are measured with the single exposure that suits them best. Rubber beside metal is rendered
in the twin too, and seconds are those of the emulated bench.
"""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks import Result, above, below
from fpplab.acquisition.acquire import acquire
from fpplab.core import config
from fpplab.core.conventions import Floats, Image
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Timed
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.phase.exposures import merged_recording
from fpplab.sessions.session import Session
from fpplab.setup.exposures import ExposureChoice, SceneLight, choose_exposures, measure_light
from fpplab.setup.live.exposure import ExposureLimits

SIZE, SHAPE = (912, 1140), (200, 320)
FULL_E, READ_E, BLACK_SHARE = 10_000.0, 8.0, 0.02
FULL_S = 0.02  # exposure in which light of 1 fills a pixel
AMBIENT, CONTRAST = 0.04, 0.8
OTHER_S, SECONDS = 0.005, 24.0  # of a frame beside its exposure; that a scan may take
LIMITS = ExposureLimits((0.0002, 2.0), (0.0, 0.0))
SETS = [{"axis": "x", "stripes": stripes, "steps": 8} for stripes in (1, 8, 64)]
PLAN = config.validate({"fringes": SETS}, Plan, "benchmark")
SEEDS = range(51_000, 51_003)
SEARCHED = 60  # sets of exposures that the choice is compared with
WITHIN = 1.1
EMULATED_S = 14.0  # that a scan may take on the emulated bench


def run() -> list[Result]:
    """Measure scenes of several seeds; five minutes on a quiet core."""
    return [result for seed in SEEDS for result in _scene(seed)] + _seconds() + _rendered()


def _seconds() -> list[Result]:
    """Seconds foretold over those that pass on the emulated bench's clock while the scan is taken."""
    world = {"mounted": "grey_card"}
    with _rig(world, "rig_emulated_quick") as (rig, folder):
        bench = rig.simulation
        assert isinstance(bench, Timed)
        plan = PLAN.model_copy(update={"trigger": "triggered"})
        chosen = _chosen(rig, plan, EMULATED_S)
        taken = _at(plan, chosen.exposures_s)
        session, began = Session.create(folder / "session", taken, rig.described()), bench.now_s()
        acquire(rig, taken, session)
        ratio = chosen.seconds / (bench.now_s() - began)
    name = "seconds_foretold_over_emulated"
    return [below(name, ratio, "", WITHIN), above(f"{name}_at_least", ratio, "", 0.9)]


def _rendered() -> list[Result]:
    """Rubber beside metal in the twin: what the choice measures, beside the best single exposure."""
    across = [0, -12, 0], [0, 8, 0]
    items = {
        name: {
            "card_mm": [60, 90],
            "material": name,
            "pose": {"rotation_deg": turned, "translation_mm": [x, 0, 450]},
        }
        for name, turned, x in (("rubber", across[0], -33), ("metal", across[1], 33))
    }
    materials = {
        "rubber": {"reflectance": 0.02},
        "metal": {"kind": "glossy", "reflectance": 0.3, "gloss": 0.6, "gloss_roughness": 0.35},
    }
    world = {"items": items, "materials": materials, "mounted": "metal", "standing": ["rubber"], "seed": 91}
    with _rig(world, "rig_demo_quick", analytic=False) as (rig, folder):
        chosen = _chosen(rig, PLAN, SECONDS)
        decoded = [_taken(rig, _at(PLAN, chosen.exposures_s), folder / name) for name in ("first", "again")]
        singles = [_taken(rig, _at(PLAN, (each,)), folder / f"{each}") for each in (0.005, 0.02, 0.08, 0.3)]
    lit = np.logical_or.reduce([each.valid for each in (*decoded, *singles)])
    complete, single = (max(float(d.valid[lit].mean()) for d in some) for some in (decoded, singles))
    both = decoded[0].valid & decoded[1].valid
    stated = np.hypot(decoded[0].sigma, decoded[1].sigma)[both]
    spread = float(np.sqrt(np.mean(((decoded[0].u - decoded[1].u)[both] / stated) ** 2)))
    return [
        above("completeness_of_choice_in_the_twin", complete, "", 0.95),
        below("completeness_of_best_single_exposure_in_the_twin", single, "", complete),
        below("repeats_apart_over_stated_in_the_twin", spread, "", WITHIN),
    ]


def _chosen(rig: Rig, plan: Plan, seconds: float) -> ExposureChoice:
    light, limits, other_s = measure_light(rig, plan, seconds)
    return choose_exposures(light, plan, rig.projector.caps.size, limits, seconds, other_s)


def _at(plan: Plan, exposures_s: Sequence[float]) -> Plan:
    several = tuple(exposures_s) if len(exposures_s) > 1 else None
    return plan.model_copy(update={"exposure_s": exposures_s[0], "exposures_s": several})


def _taken(rig: Rig, plan: Plan, folder: Path) -> Decoded:
    session = Session.create(folder, plan, rig.described())
    acquire(rig, plan, session)
    return decode(session.recording())


@contextmanager
def _rig(changed: dict[str, Any], name: str, analytic: bool = True) -> Iterator[tuple[Rig, Path]]:
    """Open a rig of the quick virtual bench with another world, and give a folder."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        world = yaml.safe_load(config.find_config("world_demo", "world").read_text()) | changed
        (folder / "world.yaml").write_text(yaml.safe_dump(world))
        optics = yaml.safe_load(config.find_config("rig_demo_quick", "rig").read_text())
        optics["bench"] |= {"world": "world.yaml", "analytic": analytic}
        (folder / "rig_demo_quick.yaml").write_text(yaml.safe_dump(optics))
        if name != "rig_demo_quick":
            (folder / f"{name}.yaml").write_text(config.find_config(name, "rig").read_text())
        with Rig.load(folder / f"{name}.yaml") as rig:
            yield rig, folder


class _Scene:
    """Rubber and metal side by side, with its own shape of both."""

    def __init__(self, seed: int) -> None:
        self.random = np.random.default_rng(seed)
        v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
        waves = self.random.uniform(15.0, 35.0, 4)
        metal = 1.5 * np.exp(0.8 * np.sin(v / waves[0]) * np.sin(u / waves[1]))
        rubber = 0.03 * np.exp(0.3 * np.sin(v / waves[2]) * np.sin(u / waves[3]))
        self.reflectance = np.where(u < SHAPE[1] // 2, rubber, metal)
        self.coordinate = 60.0 + 2.3 * u + 0.1 * v

    def frames(self, lights: Sequence[Floats], exposure_s: float) -> list[Image]:
        return [self._exposed(light, exposure_s) for light in lights]

    def _exposed(self, light: Floats, exposure_s: float) -> Image:
        mean = FULL_E * self.reflectance * (AMBIENT + (1.0 - AMBIENT) * light) * exposure_s / FULL_S
        electrons = self.random.poisson(mean) + READ_E * self.random.standard_normal(SHAPE)
        share = BLACK_SHARE + (1.0 - BLACK_SHARE) * np.minimum(electrons / FULL_E, 1.0)
        image: Image = np.rint(255.0 * share.clip(0.0, 1.0)).astype(np.uint8)
        return image

    def fringes(self) -> list[Floats]:
        sets = (each for each in PLAN.sets for _ in range(each.images))
        steps = (step for each in PLAN.sets for step in range(each.images))
        lights = (each.light(step, self.coordinate, SIZE[0]) for each, step in zip(sets, steps, strict=True))
        return [0.5 + CONTRAST * (light - 0.5) for light in lights]

    def measured(self, exposures_s: Sequence[float]) -> tuple[float, float, float]:
        """Share of the pixels that are measured right, their RMS error in px, and it over the stated one."""
        fringes = self.fringes()
        frames = [frame for each in exposures_s for frame in self.frames(fringes, each)]
        recording = Recording(frames, PLAN, SIZE)
        decoded = decode(recording if len(exposures_s) == 1 else merged_recording(recording, exposures_s))
        error = decoded.u - self.coordinate
        right = decoded.valid & (np.abs(error) < 2.0)
        stated = float(np.sqrt(np.mean((error / decoded.sigma)[right] ** 2)))
        return float(right.mean()), float(np.sqrt(np.mean(error[right] ** 2))), stated

    def light(self) -> SceneLight:
        """What is seen of it at a ladder of exposures."""
        white, black = np.full(SHAPE, 0.5 + CONTRAST / 2), np.full(SHAPE, 0.5 - CONTRAST / 2)
        fringes, exposures_s = self.fringes(), [0.96, 0.24, 0.06, 0.015, 0.00375]
        shown = [white, black, fringes[16], fringes[20]]
        frames = [frame for each in exposures_s for frame in self.frames(shown, each)]
        return SceneLight.of(frames, 8, exposures_s, np.pi)


def _scene(seed: int) -> list[Result]:
    scene = _Scene(seed)
    light = scene.light()
    single = max(scene.measured((each,))[0] for each in np.geomspace(0.002, 0.96, 13))
    three = choose_exposures(light, PLAN, SIZE, LIMITS, SECONDS, OTHER_S, most=3)
    complete, rms, stated = scene.measured(three.exposures_s)
    matt = _matt(scene, 0.5)
    matt_rms = min(matt.measured((each,))[1] for each in (0.030, 0.035, 0.038))
    chosen = choose_exposures(light, PLAN, SIZE, LIMITS, SECONDS, OTHER_S)
    auto_complete, auto_rms, _ = scene.measured(chosen.exposures_s)
    best_complete, best_rms = _searched(scene, auto_complete)
    name = f"of_seed_{seed}"
    return [
        below(f"completeness_of_best_single_exposure_{name}", single, "", 0.8),
        above(f"completeness_of_three_exposures_{name}", complete, "", 0.98),
        below(f"error_of_three_exposures_{name}", rms, "px", 1.2 * matt_rms),
        below(f"error_over_stated_{name}", stated, "", WITHIN),
        above(f"error_over_stated_at_least_{name}", stated, "", 0.9),
        above(f"completeness_of_choice_{name}", auto_complete, "", best_complete / WITHIN),
        below(f"error_of_choice_{name}", auto_rms, "px", WITHIN * best_rms),
        below(f"error_of_choice_over_foretold_{name}", auto_rms / chosen.sigma_px, "", WITHIN),
        above(f"error_of_choice_over_foretold_at_least_{name}", auto_rms / chosen.sigma_px, "", 0.9),
        below(f"completeness_foretold_off_{name}", abs(chosen.completeness - auto_complete), "", 0.05),
    ]


def _matt(scene: _Scene, reflectance: float) -> _Scene:
    """Make a matt part of the same shape."""
    matt = _Scene(int(scene.random.integers(1 << 30)))
    matt.reflectance, matt.coordinate = np.full(SHAPE, reflectance), scene.coordinate
    return matt


def _searched(scene: _Scene, completeness: float) -> tuple[float, float]:
    """Best completeness and least error of sets of exposures that take as long, drawn at random."""
    drawn = np.random.default_rng(int(scene.random.integers(1 << 30)))
    results: list[tuple[float, float]] = []
    while len(results) < SEARCHED:
        exposures_s = np.exp(drawn.uniform(np.log(0.002), np.log(0.99), drawn.integers(2, 5)))
        needed = PLAN.images * (exposures_s + OTHER_S).sum()
        if 0.5 * SECONDS <= needed <= SECONDS:
            complete, rms, _ = scene.measured(sorted(exposures_s.tolist()))
            results.append((complete, rms))
    best = max(complete for complete, _ in results)
    return best, min((rms for complete, rms in results if complete >= completeness - 0.01), default=np.inf)
