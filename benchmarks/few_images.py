"""Plans that come with fpplab beside the paper's, on the matched twin and the hidden bench.

One takes as many images, three of them along y. The search that found those of six and nine images has seen
neither the hidden bench nor these seeds.
"""

import tempfile
from pathlib import Path
from statistics import fmean

from benchmarks import Result
from fpplab.cli import console
from fpplab.devices.rig import Rig
from fpplab.optimisation.arrangement import with_calibrations
from fpplab.optimisation.candidate import Candidate
from fpplab.optimisation.measuring import RigEvaluator
from fpplab.optimisation.study import Study
from fpplab.patterns.plan import Plan

PAPER = "plan_paper"
PLANS = {"plan_scan": 1.2, "plan_six_images": 1.0, "plan_nine_images": 1.5}
"""How many times better than the paper's plan each has to be."""
RIGS = ("matched_still", "hidden")
SEEDS = (201, 202, 203)


def run() -> list[Result]:
    """Measure; half an hour on two cores, most of it for the hidden bench's light."""
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        return [result for name in RIGS for result in rig_figures(name, Path(folder))]


def rig_figures(name: str, folder: Path) -> list[Result]:
    """Measure all plans on one rig."""
    file = f"rig_{name}.yaml"
    with Rig.load(file) as rig, console.progress(f"Characterising {name}") as report:
        study = with_calibrations(rig, Study.load("study_phases.yaml"), folder / name, report)
    paper, *few = (_smcd_um(file, study, Plan.load(plan)) for plan in (PAPER, *PLANS))
    console.log_status(f"{name}: {paper:.2f} um with {PAPER}")
    return [
        Result(f"{plan[5:]}_{name}", found, "um", paper / least, paper / least / found)
        for (plan, least), found in zip(PLANS.items(), few, strict=True)
    ]


def _smcd_um(rig: str, study: Study, plan: Plan) -> float:
    """Mean over artefacts and seeds; tells wrong orders and completeness too."""
    evaluator = RigEvaluator(rig, study.model_copy(update={"start": plan}))
    try:
        candidate = Candidate.of(plan)
        scores = [score for seed in SEEDS for score in evaluator.measure(candidate, seed)]
    finally:
        evaluator.close()
    worst, least = max(s.wrong_orders for s in scores), min(s.completeness for s in scores)
    console.log_status(
        f"{plan.images} images: at most {worst:.2g} wrong orders, completeness at least {least:.4f}"
    )
    return fmean(score.surface_smcd_um for score in scores)
