"""What a twin predicts for ten plans, beside what `compare --align` then says of its bench's scans.

The bench's world is drawn as of `benchmarks.hidden`. Its twin knows the light, and the geometry by the
bench's own characterisation alone: predictions are judged without the errors of a matching.
"""

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from benchmarks import Result, above, below
from benchmarks.hidden.bench import write_rig
from benchmarks.hidden.worlds import BOARD, SHAPES, drawn_world
from benchmarks.virtual import virtual_bench
from fpplab.artefacts.recognition import recognise
from fpplab.calibration.model import Calibration, CalibrationFile
from fpplab.cli import console
from fpplab.comparison import Comparison, compare
from fpplab.core.conventions import Floats
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.pipeline.characterising import characterise_sessions
from fpplab.pipeline.measuring import reconstruct_points
from fpplab.pipeline.taking import take_or_resume_session, take_poses
from sim.prediction import Prediction, predict

SEEDS = (7410, 7411, 7412)
"""Of the benches that judge; 7000 to 7009 are for development."""
POSES, BINNING = 6, 8
REPEATS = 2  # scans of a bench by the same plan: what differs by less than they do has no rank
NEAR, LEAST_NEAR, LEAST_COVERED = 0.10, 0.90, 0.90


@dataclass(frozen=True, eq=False)
class PredictedPlan:
    """A plan, what was predicted for it, and what scans by it gave."""

    item: str
    name: str
    said: Prediction
    measured: tuple[Comparison, ...]  # of repeated scans

    @property
    def distances(self) -> Floats:
        """Distances after the alignment of each scan in µm."""
        return np.array([one.surface_smcd_um for one in self.measured], np.float64)

    @property
    def lengths_in(self) -> list[bool]:
        """Whether each length of the first scan lies in its interval."""
        found = {one.name: one.measured_mm for one in self.measured[0].lengths}
        values = [(one.measured_mm, found[one.name]) for one in self.said.lengths]
        return [said.contains(value) for said, value in values if value is not None]


def ten_plans() -> dict[str, Plan]:
    """Plans of 6 to 48 images whose distances are from one to several times the least."""
    named = {name: Plan.load(f"plan_{name}.yaml") for name in ("scan", "paper", "nine_images", "six_images")}
    coarse = named["paper"]

    def of(stripes: Sequence[float], steps: Sequence[int], exposure: float = 1.0) -> Plan:
        sets = tuple(Sinusoid(axis="x", stripes=n, steps=m) for n, m in zip(stripes, steps, strict=True))
        return coarse.model_copy(update={"fringes": sets, "exposure_s": exposure * coarse.exposure_s})

    return named | {
        "few_steps": of((1, 8, 64), (4, 4, 4)),
        "wide": of((1, 6, 32), (6, 6, 12)),
        "wide_few_steps": of((1, 6, 32), (4, 4, 4)),
        "fine": of((1, 8, 64, 160), (6, 6, 6, 9)),
        "short": of((1, 8, 64), (12, 12, 12), 0.25),
        "coarse": of((1, 16), (8, 16)),
    }


def run() -> list[Result]:
    """Predict and measure; it takes some minutes a seed."""
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        items = zip(SEEDS, SHAPES, strict=True)
        return plan_figures([judged_plans(seed, item, Path(folder) / str(seed)) for seed, item in items])


def judged_plans(seed: int, item: str, folder: Path) -> list[PredictedPlan]:
    """Characterise a bench, predict ten plans on its twin, and measure by them."""
    world = drawn_world(seed, POSES, BINNING)
    plans = ten_plans()
    with Rig.load(write_rig(world, folder / "bench", "Bench")) as rig:
        console.log_status(f"Bench {seed}: characterising")
        board = Plan.load("plan_board.yaml")
        poses = take_poses(rig, board, BOARD, POSES, folder / "poses", replace_existing=False)
        target = virtual_bench(rig).twin(BOARD).target
        known = characterise_sessions(poses, target).calibration
        twin = world.model_copy(update={"calibration": CalibrationFile.of(known)})
        path = write_rig(twin, folder / "twin", "Twin")
        known.save(path.parent / "calibration.yaml")
        with Rig.load(path) as simulated:
            said = {name: predict(simulated, plan, item) for name, plan in plans.items()}
        found = []
        for name, plan in plans.items():
            found.append(PredictedPlan(item, name, said[name], _scans(rig, plan, item, folder / name, known)))
            console.log_status(_line(found[-1]))
    return found


def _scans(rig: Rig, plan: Plan, item: str, folder: Path, known: Calibration) -> tuple[Comparison, ...]:
    mesh, compared = virtual_bench(rig).image_part_sampler().mesh(item), []
    for repeat in range(REPEATS):
        session = take_or_resume_session(rig, plan, folder / str(repeat), (item, 0))
        cloud = reconstruct_points(session, known)[1]
        compared.append(compare(cloud, mesh, known, align=True, artefact=recognise(mesh)))
    return tuple(compared)


def _line(one: PredictedPlan) -> str:
    said = one.said.figures["distance_um"]
    return (
        f"{one.item} {one.name}: predicted {said.value:.2f} ({said.low:.2f} to {said.high:.2f}) µm, measured "
        f"{', '.join(f'{value:.2f}' for value in one.distances)} µm; lengths in their intervals "
        f"{sum(one.lengths_in)} of {len(one.lengths_in)}"
    )


def misranked(plans: Sequence[PredictedPlan]) -> int:
    """Count pairs that were predicted in another order than measured, of those that the scans tell apart."""
    wrong = 0
    for a, b in combinations(plans, 2):
        first, second = (a, b) if a.distances.mean() < b.distances.mean() else (b, a)
        apart = first.distances.max() < second.distances.min()
        ordered = first.said.figures["distance_um"].value < second.said.figures["distance_um"].value
        wrong += apart and not ordered
    return wrong


def plan_figures(benches: Sequence[Sequence[PredictedPlan]]) -> list[Result]:
    """Sum up benches."""
    every = [one for plans in benches for one in plans]
    said = [one.said.figures["distance_um"] for one in every]
    middles = [float(np.median(one.distances)) for one in every]
    off = np.array([abs(a.value / b - 1.0) for a, b in zip(said, middles, strict=True)])
    inside = [a.contains(x) for a, one in zip(said, every, strict=True) for x in one.distances]
    lengths = [held for one in every for held in one.lengths_in]
    return [
        above("predict_plans_within_10_percent", float(np.mean(off <= NEAR)), "share", LEAST_NEAR),
        below("predict_plans_off", float(np.median(off)), "relative", NEAR),
        below("predict_plans_misranked", sum(misranked(plans) for plans in benches), "pairs", 0.0),
        above("predict_plans_intervals_cover", float(np.mean(inside)), "share", LEAST_COVERED),
        above("predict_plans_lengths_cover", float(np.mean(lengths)), "share", LEAST_COVERED),
    ]
