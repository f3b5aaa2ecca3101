"""The whole of a search: a study on a rig, its plans on disk, and its figures."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from fpplab.core import config
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import write_text
from fpplab.core.progress import Progress, ignore, no_progress
from fpplab.devices.rig import Rig
from fpplab.optimisation.arrangement import characterise_positions
from fpplab.optimisation.candidate import Candidate, Score
from fpplab.optimisation.candidate_runner import (
    BudgetExhausted,
    CandidateObserver,
    CandidateRunner,
    SearchEpoch,
)
from fpplab.optimisation.confirm import Confirmation, confirm
from fpplab.optimisation.limits import RigLimits
from fpplab.optimisation.measuring import RigEvaluator
from fpplab.optimisation.objectives import CandidateFigures, CandidateRanking, MeasuredCandidate, seed_means
from fpplab.optimisation.scheduling import EvaluatorFactory, RigEvaluatorFactory, make_workers
from fpplab.optimisation.scope import SearchScope
from fpplab.optimisation.space import SearchSpace
from fpplab.optimisation.storage import Journal
from fpplab.optimisation.study import CalibrationAt, Study
from fpplab.patterns.plan import Plan
from fpplab.pipeline import CALIBRATION, REPORT
from fpplab.targets import Target

WORKER_BYTES = 4 << 30
"""Memory of a process that measures on a simulation: light tables, and the frames of sets."""
JOURNAL = "study.jsonl"
"""The journal in the folder of a front; that of a single plan is named as the plan."""


@dataclass(frozen=True)
class Gain:
    """By how much the mean distance came down, each seed compared with itself.

    uncertainty_um: standard uncertainty over the seeds, None with one.
    """

    down_um: float
    uncertainty_um: float | None
    down_percent: float


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What a search came to.

    again: scores of plans with seeds that the search has not seen, which chose none of them. ended: why.
    plans: files written, of a front in its order; planned: what they stand for.
    """

    study: Study
    rig: str
    space: SearchSpace
    start: MeasuredCandidate
    optimum: MeasuredCandidate
    front: tuple[MeasuredCandidate, ...]
    epochs: tuple[SearchEpoch, ...]
    trials: tuple[MeasuredCandidate, ...]
    refused: dict[str, int]
    again: dict[Candidate, tuple[Score, ...]]
    ended: str
    plans: tuple[Path, ...]
    planned: tuple[MeasuredCandidate, ...]

    @property
    def ranking(self) -> CandidateRanking:
        """What the study makes of trials."""
        return CandidateRanking(self.study, self.start.figures)

    @property
    def gain(self) -> Gain | None:
        """Of the optimum over the start, with the other seeds; None where they measured nothing."""
        return _gain(self.again[self.start.candidate], self.again[self.optimum.candidate])

    def summary(self) -> dict[str, Any]:
        """The figures for a machine to read, as the command line prints them."""
        return {
            "study": self.study.name,
            "rig": self.rig,
            "initial": self._described(self.start),
            "optimum": self._described(self.optimum),
            "gain": asdict(self.gain) if self.gain else None,
            "epochs": len(self.epochs),
            "ended": self.ended,
            "images": self.optimum.candidate.images,
            "front": [self._described(trial) for trial in self.front],
            "candidates": len(self.trials),
            "failed": sum(not trial.measured for trial in self.trials),
            "refused": self.refused,
            "convergence": [self._epoch(epoch) for epoch in self.epochs],
        }

    def _described(self, trial: MeasuredCandidate) -> dict[str, Any]:
        scores = self.again.get(trial.candidate)
        return {**trial.summary(), "again": asdict(CandidateFigures.of(scores)) if scores else None}

    def _epoch(self, epoch: SearchEpoch) -> dict[str, Any]:
        best = epoch.best.figures
        return {
            "epoch": epoch.number,
            "step": epoch.step,
            "candidates": epoch.measured,
            "surface_smcd_um": best.surface_smcd_um,
            "images": best.images,
        }


def _gain(before: Sequence[Score], after: Sequence[Score]) -> Gain | None:
    if not before or not after:
        return None
    first, then = (np.array(list(seed_means(scores).values())) for scores in (before, after))
    down = first - then
    return Gain(
        down_um=float(down.mean()),
        uncertainty_um=float(down.std(ddof=1) / np.sqrt(len(down))) if len(down) > 1 else None,
        down_percent=float(100.0 * down.mean() / first.mean()),
    )


def run_search(
    what: SearchScope,
    rig: str,
    study: Study,
    out: Path,
    source: str,
    *,
    workers: int | None = 1,
    scheduler: str | None = None,
    factory: EvaluatorFactory | None = None,
    observe: CandidateObserver = ignore,
    progress: Progress = no_progress,
) -> SearchResult:
    """Search, and leave the plan in `out`, or a front's plans in the folder `out`.

    Goes on where a journal beside them ends. source: names the study in complaints. factory: of the rig to
    measure on, by default `rig` itself. workers: processes, None for as many as help. Raises `ConfigError`
    for a study that fits neither `what` nor the rig, and for several workers of a rig that is not a
    simulation; `DataError` when no plan keeps the limits.
    """
    with Rig.load(rig) as opened:
        limits, file = RigLimits.of(opened), opened.file.model_dump(mode="json")
        study.check_rig(limits.name, source)
        _check_artefacts(study, limits, source)
        space = SearchSpace.of(study, limits, source)
        _check_what(what, space, source)
        count = worker_count(limits, workers)
        if scheduler is not None:  # told before the rig is characterised, which takes its time
            make_workers(RigEvaluatorFactory(_absolute(rig), study), count, scheduler).close()
        if factory is None and not study.calibrations:
            study = with_calibrations(opened, study, work_folder(out), progress)
    journal = Journal(journal_path(what, out), study, file)
    measuring = make_workers(factory or RigEvaluatorFactory(_absolute(rig), study), count, scheduler)
    try:
        runner = CandidateRunner(space, measuring, journal, observe)
        ended = _search(runner)
        optimum = runner.best
        _check_wanted(runner, optimum)
        front = tuple(runner.front)
        chosen = list(dict.fromkeys(t.candidate for t in (runner.start, optimum, *front)))
        again = dict(zip(chosen, runner.rescore(chosen, _other_seeds(study)), strict=True))
    finally:
        measuring.close()
    planned = front if what is SearchScope.PARETO else (optimum,)
    return SearchResult(
        study=study,
        rig=limits.name,
        space=space,
        start=runner.start,
        optimum=optimum,
        front=front,
        epochs=tuple(runner.epochs),
        trials=tuple(runner.trials),
        refused=dict(runner.refused),
        again=again,
        ended=ended,
        plans=_save(what, out, study, limits, rig, planned),
        planned=planned,
    )


@dataclass(frozen=True, eq=False)
class ConfirmedPlan:
    """A plan found, and the plan of the start, measured on a rig."""

    rig: str
    plan: Path
    images: int
    confirmation: Confirmation

    def summary(self) -> dict[str, Any]:
        """For a machine to read."""
        return {
            "rig": self.rig,
            "plan": str(self.plan),
            "images": self.images,
            **self.confirmation.summary(),
        }


def check_confirmable(rig: str, study: Study, source: str) -> None:
    """Refuse a rig that cannot hold the artefacts of a study: `ConfigError`."""
    with Rig.load(rig) as opened:
        _check_artefacts(study, RigLimits.of(opened), source)


def confirm_result(
    rig: str, found: SearchResult, folder: Path, progress: Progress = no_progress
) -> tuple[ConfirmedPlan, ...]:
    """Measure the artefacts on a rig with the plan of the start and with what was found.

    Of a front the two ends and the middle. The rig is characterised in `folder` unless it is the one
    searched on. Raises `ConfigError` for a plan outside the rig's limits, and what measuring raises.
    """
    chosen = sorted({0, len(found.plans) // 2, len(found.plans) - 1})
    trials = [(found.plans[i], found.planned[i]) for i in chosen]
    study = found.study
    with Rig.load(rig) as opened:
        limits = RigLimits.of(opened)
        for path, trial in trials:
            limits.check(trial.candidate, str(path))
        if limits.name != found.rig:
            stands = [mm for _, trial in trials if (mm := trial.candidate.stage_mm) is not None]
            study = with_calibrations(opened, study, folder, progress, stands)
    return tuple(
        ConfirmedPlan(
            rig=limits.name,
            plan=path,
            images=trial.candidate.images,
            confirmation=confirm(rig, study, study.start, Plan.load(path), progress=progress),
        )
        for path, trial in trials
    )


def worker_count(limits: RigLimits, wanted: int | None) -> int:
    """How many measure: as wanted, or one for every core where the rig is a simulation and memory allows."""
    if wanted is None:
        fit = psutil.virtual_memory().available // WORKER_BYTES
        return max(1, min(os.cpu_count() or 1, fit)) if limits.allows_copies else 1
    if wanted > 1 and not limits.allows_copies:
        raise ConfigError(
            f"--workers {wanted}: rig '{limits.name}' is no simulation, and instruments serve one process; "
            "leave --workers out"
        )
    return wanted


def _absolute(rig: str) -> str:
    """The rig's file for a worker that runs elsewhere; the name of one that comes with fpplab stays."""
    return str(Path(rig).resolve()) if Path(rig).exists() else rig


def with_calibrations(
    rig: Rig,
    study: Study,
    folder: Path,
    progress: Progress = no_progress,
    stands: Sequence[float] | None = None,
) -> Study:
    """The study with calibrations of the open rig, characterised at the ends of where the stage may stand.

    stands: where it will, beside the start; anywhere that is searched if None. Sessions and calibrations stay
    in `folder`, and what is there already is kept.
    """
    searched, start = study.space.stage_mm, study.start.stage_mm
    positions: Sequence[float | None] = [start]
    if searched is not None:
        among = (start or 0.0, *(stands or searched))
        positions = sorted({min(among), among[0], max(among)})
    board = study.board
    files = characterise_positions(
        rig,
        positions,
        Plan.load(board.plan),
        board.item,
        Target.load(board.target),
        board.poses,
        folder / "board",
        progress,
    )
    known = tuple(CalibrationAt(file=str(path.resolve()), stage_mm=mm) for mm, path in files.items())
    return study.model_copy(update={"calibrations": known})


def work_folder(out: Path) -> Path:
    """Where what belongs to a search is kept: the folder of a front, or one named as the plan."""
    return out.with_suffix("")


def journal_path(what: SearchScope, out: Path) -> Path:
    """Where the measurements of a search are kept."""
    return out / JOURNAL if what is SearchScope.PARETO else out.with_suffix(".jsonl")


def report_path(what: SearchScope, out: Path) -> Path:
    """Where the report of a search goes."""
    return out / REPORT if what is SearchScope.PARETO else out.with_suffix(".html")


def plan_paths(what: SearchScope, out: Path) -> list[Path]:
    """The plans that a search has left, each of which says that it ended."""
    return sorted(out.glob("plan_*.yaml")) if what is SearchScope.PARETO else [out] if out.exists() else []


def _search(runner: CandidateRunner) -> str:
    """Run the study's method; returns why it ended."""
    runner.epoch("start", [runner.start])
    try:
        return runner.space.study.method.search(runner)
    except BudgetExhausted:
        return f"the budget of {runner.space.study.budget} candidates is used up"


def _other_seeds(study: Study) -> list[int]:
    """As many that the search has not seen: what it chose, it chose for luck with its own, too."""
    first = max(study.seeds) + 1
    return list(range(first, first + len(study.seeds)))


def _check_artefacts(study: Study, limits: RigLimits, source: str) -> None:
    for name in study.artefacts:
        if limits.items is not None and name not in limits.items:
            raise ConfigError(
                f"{source}: 'artefacts' names '{name}', and the fixture of rig '{limits.name}' holds "
                f"{', '.join(sorted(limits.items))}"
            )


def _check_what(what: SearchScope, space: SearchSpace, source: str) -> None:
    """Refuse a study that searches something else than is asked for."""
    foreign = [p.name for p in space.parameters if p.group not in what.groups]
    if foreign:
        raise ConfigError(
            f"{source}: 'space' searches {', '.join(foreign)}, which `optimise {what}` does not; use "
            "`optimise pareto`, or leave them out"
        )
    if (what is SearchScope.PARETO) != (len(space.study.objectives) > 1):
        wanted = "several" if what is SearchScope.PARETO else "one"
        raise ConfigError(f"{source}: 'objectives' must name {wanted} for `optimise {what}`")


def _check_wanted(runner: CandidateRunner, optimum: MeasuredCandidate) -> None:
    broken = {name: by for name, by in runner.ranking.violations(optimum).items() if by > 0}
    if broken:
        words = ", ".join(f"{name} by {by:.3g}" for name, by in broken.items())
        raise DataError(
            f"no plan of {len(runner.trials)} measured keeps the study's limits; the best breaks {words}"
        )


def _save(
    what: SearchScope,
    out: Path,
    study: Study,
    limits: RigLimits,
    rig: str,
    planned: Sequence[MeasuredCandidate],
) -> tuple[Path, ...]:
    """Write the plans, and the calibration that holds where the stage puts the projector."""
    paths = []
    with closing(RigEvaluator(rig, study)) as evaluator:
        for number, trial in enumerate(planned, 1):
            name = f"plan_{number:02d}_{trial.candidate.images}images.yaml"
            path = out / name if what is SearchScope.PARETO else out
            if study.space.stage_mm is not None and study.calibrations:
                calibration = evaluator.calibrations.at(trial.candidate.stage_mm)
                calibration.save(path.with_name(f"{path.stem}_{CALIBRATION}"))
            write_text(path, plan_text(study, limits.name, trial))
            paths.append(path)
    return tuple(paths)


def plan_text(study: Study, rig: str, trial: MeasuredCandidate) -> str:
    """The plan of a trial as a file that `fpplab scan` takes, headed by what it came to."""
    found, candidate = trial.figures, trial.candidate
    head = [
        f"# Found by the study '{study.name}' on '{rig}': {found.surface_smcd_um:.2f} µm mean distance to "
        f"the surface, {candidate.images} images."
    ]
    if candidate.convergence_deg:
        head.append(f"# Turn the projector by {candidate.convergence_deg:g} degrees towards the camera.")
    plan = candidate.plan(study.start)
    shown = {"unwrapping": plan.unwrapping, "exposure_s": plan.exposure_s}
    data = plan.model_dump(mode="json", exclude_defaults=True)
    return "\n".join([*head, config.to_yaml({"fringes": data["fringes"], **shown, **data})])
