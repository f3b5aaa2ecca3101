"""A study of seconds: how much quicker a plan it finds is than 36 images that come as near to the surface.

The search predicts candidates on the twin; what it finds is judged by other seeds, and timed beside the start
by the emulated projector's and camera's clocks.
"""

import tempfile
from contextlib import suppress
from pathlib import Path
from statistics import fmean

from benchmarks import Result, above, below
from benchmarks.few_bits import scan_seconds
from drivers.dlp4500.sequence import SIZE as FLASH
from fpplab.core import config
from fpplab.core.conventions import Lattice
from fpplab.devices.rig import Rig
from fpplab.optimisation.candidate import Candidate, MeasuredCandidate
from fpplab.optimisation.candidate_runner import BudgetExhausted, CandidateRunner
from fpplab.optimisation.limits import RigLimits
from fpplab.optimisation.scheduling import InProcessWorkers
from fpplab.optimisation.screening import SampledEvaluator
from fpplab.optimisation.space import SearchSpace
from fpplab.optimisation.storage import Journal
from fpplab.optimisation.study import Study
from fpplab.patterns.fringes import make_patterns
from tests.drivers.emulated_rig import burn, rig_file

RIG, BUDGET = "rig_demo_quick", 40
SEARCHED, JUDGED = (39_601, 39_602), (39_611, 39_612, 39_613)  # seeds
FASTER, MARGIN = (
    5.0,
    0.97,
)  # of the start's distance that the plan taken may have: the search has chosen by chance


def run() -> list[Result]:
    """Search, judge and time; two minutes on a quiet core."""
    study = Study.load("study_seconds").model_copy(update={"budget": BUDGET, "seeds": SEARCHED})
    with Rig.load(RIG) as rig:
        space = SearchSpace.of(study, RigLimits.of(rig), "the benchmark")
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        journal = Journal(Path(folder) / "study.jsonl", study, {})
        workers = InProcessWorkers(lambda: SampledEvaluator(RIG, study))
        runner = CandidateRunner(space, workers, journal)
        with suppress(BudgetExhausted):
            study.method.search(runner)
        quickest = min(filter(lambda each: _is_as_near(runner, each), runner.trials), key=_seconds_of)
        both = (runner.start.candidate, quickest.candidate)
        near, found = (fmean(s.surface_smcd_um for s in each) for each in runner.rescore(both, JUDGED))
        paper_s, found_s = _timed(Path(folder), both, study)
    return [
        below("distance_of_plan_found", found, "um", near),
        above("times_as_fast_as_start", paper_s / found_s, "", FASTER),
    ]


def _seconds_of(each: MeasuredCandidate) -> float:
    return each.figures.seconds


def _is_as_near(runner: CandidateRunner, each: MeasuredCandidate) -> bool:
    if each.failed or each.refused or not runner.ranking.is_acceptable(each):
        return False
    return each.figures.surface_smcd_um <= MARGIN * runner.start.figures.surface_smcd_um


def _timed(folder: Path, candidates: tuple[Candidate, ...], study: Study) -> list[float]:
    """Seconds of scans in step with the emulated projector."""
    start = study.start.model_copy(update={"trigger": "triggered"})
    plans = [candidate.plan(start) for candidate in candidates]
    burn(folder, [p for plan in plans for p in make_patterns(plan, FLASH, Lattice.DIAMOND)])
    optics = {"optics": str(config.find_config(RIG, "rig"))}
    with rig_file(folder, optics, {"bits": 8, "roi": [0, 0, 684, 456]}) as rig:
        return [scan_seconds(rig, plan) for plan in plans]
