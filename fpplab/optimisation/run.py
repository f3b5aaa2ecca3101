"""Runs a search from the study to the plans on disk."""

import os
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import psutil

from fpplab.core import config
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.files import write_text
from fpplab.core.progress import Progress, ignore, no_progress
from fpplab.core.session_names import CALIBRATION, REPORT
from fpplab.devices.rig import Rig
from fpplab.optimisation.arrangement import with_calibrations
from fpplab.optimisation.candidate import MeasuredCandidate
from fpplab.optimisation.candidate_runner import BudgetExhausted, CandidateObserver, CandidateRunner
from fpplab.optimisation.cluster import Meeting
from fpplab.optimisation.limits import RigLimits
from fpplab.optimisation.measuring import RigEvaluator, RigEvaluatorFactory
from fpplab.optimisation.result import SearchResult
from fpplab.optimisation.scheduling import EvaluatorFactory, make_workers
from fpplab.optimisation.scope import SearchScope
from fpplab.optimisation.screening import SampledEvaluator, can_screen
from fpplab.optimisation.search_method import SearchMethod
from fpplab.optimisation.space import SearchSpace
from fpplab.optimisation.storage import Journal
from fpplab.optimisation.study import Study
from fpplab.optimisation.verdict import diagnose_search

JOURNAL = "study.jsonl"
"""Name of the journal in the folder of a front; that of a single plan is named as the plan."""


def run_search(
    scope: SearchScope,
    rig: str,
    study: Study,
    out: Path,
    source: str,
    *,
    workers: int | None = 1,
    scheduler: Meeting | None = None,
    factory: EvaluatorFactory | None = None,
    observe: CandidateObserver = ignore,
    progress: Progress = no_progress,
) -> SearchResult:
    """Search, and write the plan found to `out`, or the plans of a front to the folder `out`."""
    with Rig.load(rig) as opened:
        limits, file = RigLimits.of(opened), opened.file.model_dump(mode="json")
        study.check_rig(limits.name, source)
        limits.check_items(study.artefacts, source)
        space = SearchSpace.of(study, limits, source)
        _check_scope(scope, space, source)
        count = worker_count(limits, workers)
        if scheduler is not None:  # a wrong address fails before the long characterisation
            make_workers(RigEvaluatorFactory(_absolute(rig), study), count, scheduler).close()
        screened = factory is None and can_screen(opened, study)
        if factory is None and not study.calibrations:
            study = with_calibrations(opened, study, work_folder(out), progress)
    measured, predicted = (Journal(path, study, file) for path in journal_paths(scope, out))
    measuring = factory or RigEvaluatorFactory(_absolute(rig), study)
    searching = RigEvaluatorFactory(_absolute(rig), study, SampledEvaluator) if screened else measuring
    with closing(make_workers(searching, count, scheduler)) as searchers:
        runner = CandidateRunner(space, searchers, predicted if screened else measured, observe)
        ended, ended_early = _run_search_method(runner, study.method)
        optimum = runner.best
        _check_acceptable(runner, optimum)
        front = tuple(runner.front)
        chosen = list(dict.fromkeys(t.candidate for t in (runner.start, optimum, *front)))
        other_scores = [] if screened else runner.rescore(chosen, _other_seeds(study))
    if screened:
        with closing(make_workers(measuring, count, scheduler)) as measurers:
            other_scores = CandidateRunner(space, measurers, measured).rescore(chosen, _other_seeds(study))
    rescored = dict(zip(chosen, other_scores, strict=True))
    planned = front if scope is SearchScope.PARETO else (optimum,)
    result = SearchResult(
        study=study,
        rig=limits.name,
        space=space,
        start=runner.start,
        optimum=optimum,
        front=front,
        epochs=tuple(runner.epochs),
        trials=tuple(runner.trials),
        refused=dict(runner.refused),
        rescored=rescored,
        ended=ended,
        plans=(),
        planned=planned,
        ended_early=ended_early,
        screened=screened,
    )
    if diagnose_search(result).is_useless:
        return result
    return replace(result, plans=_save_plans_and_calibration(scope, out, result, limits, rig))


def worker_count(limits: RigLimits, workers: int | None) -> int:
    if workers is None:
        # 4 GiB for each process, chosen: light tables, and the frames of fringe sets.
        fit = psutil.virtual_memory().available // (4 << 30)
        return max(1, min(os.cpu_count() or 1, fit)) if limits.allows_copies else 1
    if workers > 1 and not limits.allows_copies:
        raise ConfigError(
            f"--workers {workers}: rig '{limits.name}' is no simulation, and instruments serve one process; "
            "leave --workers out"
        )
    return workers


def _absolute(rig: str) -> str:
    """Make a rig file's path absolute for a worker elsewhere; a name that comes with fpplab stays."""
    return str(Path(rig).resolve()) if Path(rig).exists() else rig


def work_folder(out: Path) -> Path:
    return out.with_suffix("")


def journal_paths(scope: SearchScope, out: Path) -> tuple[Path, Path]:
    if scope is SearchScope.PARETO:
        return out / JOURNAL, out / f"predicted_{JOURNAL}"
    return out.with_suffix(".jsonl"), out.with_suffix(".predicted.jsonl")


def report_path(scope: SearchScope, out: Path) -> Path:
    return out / REPORT if scope is SearchScope.PARETO else out.with_suffix(".html")


def plan_paths(scope: SearchScope, out: Path) -> list[Path]:
    """List the plans that a search has written, which it does only at its end."""
    return sorted(out.glob("plan_*.yaml")) if scope is SearchScope.PARETO else [out] if out.exists() else []


def _run_search_method(runner: CandidateRunner, method: SearchMethod) -> tuple[str, bool]:
    """Run a search method; returns why it ended, and whether that was too early."""
    runner.epoch("start", [runner.start])
    try:
        return method.search(runner), False
    except BudgetExhausted:
        return f"the budget of {runner.space.problem.budget} candidates is used up", True


def _other_seeds(study: Study) -> list[int]:
    """Return as many unused seeds: with those of the search, the optimum is partly chosen by luck."""
    first = max(study.seeds) + 1
    return list(range(first, first + len(study.seeds)))


def _check_scope(scope: SearchScope, space: SearchSpace, source: str) -> None:
    foreign = [p.name for p in space.parameters if p.group not in scope.groups]
    if foreign:
        raise ConfigError(
            f"{source}: 'space' searches {', '.join(foreign)}, which `optimise {scope}` does not; use "
            "`optimise pareto`, or leave them out"
        )
    if (scope is SearchScope.PARETO) != (len(space.problem.objectives) > 1):
        number = "several" if scope is SearchScope.PARETO else "one"
        raise ConfigError(f"{source}: 'objectives' must name {number} for `optimise {scope}`")


def _check_acceptable(runner: CandidateRunner, optimum: MeasuredCandidate) -> None:
    broken = {name: by for name, by in runner.ranking.violations(optimum).items() if by > 0}
    if broken:
        violations = ", ".join(f"{name} by {by:.3g}" for name, by in broken.items())
        raise DataError(
            f"no plan of {len(runner.trials)} measured keeps the study's limits; the best breaks {violations}"
        )


def _save_plans_and_calibration(
    scope: SearchScope, out: Path, result: SearchResult, limits: RigLimits, rig: str
) -> tuple[Path, ...]:
    paths, study = [], result.study
    with closing(RigEvaluator(rig, study)) as evaluator:
        for number, trial in enumerate(result.planned, 1):
            name = f"plan_{number:02d}_{trial.candidate.images}images.yaml"
            path = out / name if scope is SearchScope.PARETO else out
            if study.space.stage_mm is not None and study.calibrations:
                calibration = evaluator.calibrations.at(trial.candidate.stage_mm)
                calibration.save(path.with_name(f"{path.stem}_{CALIBRATION}"))
            scores = result.rescored[trial.candidate] if result.screened else ()
            rescored = replace(trial, scores=scores) if scores else trial
            write_text(path, plan_text(study, limits.name, rescored))
            paths.append(path)
    return tuple(paths)


def plan_text(study: Study, rig: str, trial: MeasuredCandidate) -> str:
    figures, candidate = trial.figures, trial.candidate
    head = [
        f"# Found by the study '{study.name}' on '{rig}': {figures.surface_smcd_um:.2f} µm mean distance to "
        f"the surface, {candidate.images} images."
    ]
    if candidate.convergence_deg:
        head.append(f"# Turn the projector by {candidate.convergence_deg:g} degrees towards the camera.")
    plan = candidate.plan(study.start)
    shown = {"unwrapping": plan.unwrapping, "exposure_s": plan.exposure_s}
    data = plan.model_dump(mode="json", exclude_defaults=True)
    return "\n".join([*head, config.to_yaml({"fringes": data["fringes"], **shown, **data})])
