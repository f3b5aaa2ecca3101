"""Search for a better plan, confirm it on another rig, and compare it with the start."""

from __future__ import annotations

from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from fpplab.core.errors import ConfigError
from fpplab.core.extras import need_extra
from fpplab.core.files import need_suffix
from fpplab.optimisation.scope import SearchScope
from fpplab.results.observer import Observer
from fpplab.workflows.stopwatch import Stopwatch

if TYPE_CHECKING:
    from fpplab.optimisation.candidate import Candidate
    from fpplab.optimisation.confirm import ConfirmedPlan
    from fpplab.optimisation.measuring import RigEvaluator
    from fpplab.optimisation.result import SearchResult
    from fpplab.optimisation.study import Study
    from fpplab.results.search import BeforeAndAfter, MeasuredArtefact, OptimisationResult


@dataclass(frozen=True, eq=False)
class OptimisationRequest:
    """What to search, on which rig, and where the plans go."""

    scope: SearchScope
    rig: str  # rig file, or the name of one that comes with fpplab; each worker opens it
    study: Study
    study_name: str  # as messages call it
    out: Path  # plan (.yaml); of `pareto` the folder of its plans
    workers: int | None = None  # processes that measure
    scheduler: str | None = None  # address of a dask scheduler whose workers measure
    certificate: Path | None = None  # folder of the one that the scheduler is met with
    confirm: str | None = None  # rig on which the plan found is compared with the start's
    force: bool = False  # whether existing files are replaced

    @property
    def page(self) -> Path:
        from fpplab.optimisation.run import report_path

        return report_path(self.scope, self.out)


def run_optimisation(request: OptimisationRequest, observer: Observer | None = None) -> OptimisationResult:
    """Search, confirm where asked to, judge the optimum; write its report, and its plans unless useless."""
    prepare_output(request)
    need_extra("optuna")
    need_extra("distributed")

    from fpplab.optimisation import confirm, run
    from fpplab.optimisation.cluster import Meeting
    from fpplab.optimisation.verdict import diagnose_search
    from fpplab.report.optimisation import write_optimisation_report
    from fpplab.results.search import OptimisationResult

    observer = observer or Observer()
    if request.confirm:
        confirm.check_confirmable(request.confirm, request.study, request.study_name)
    scheduler = Meeting.at(request.scheduler, request.certificate) if request.scheduler else None
    stopwatch = Stopwatch()
    with observer.stage("Searching") as progress:
        search = run.run_search(
            request.scope,
            request.rig,
            request.study,
            request.out,
            request.study_name,
            workers=request.workers,
            scheduler=scheduler,
            observe=observer.result,
            progress=progress,
        )
    confirmed = _confirm_with_other_seeds(request, search, observer)
    diagnosis = diagnose_search(search, confirmed)
    if diagnosis.is_useless:
        for path in search.plans:
            path.unlink()
    seconds = stopwatch.seconds
    with observer.stage("Comparing before and after"):
        compared = compare_before_and_after(request.rig, search)
        result = OptimisationResult(search, diagnosis, request.page, confirmed, seconds, compared)
        write_optimisation_report(request.page, result)
    return result


def prepare_output(request: OptimisationRequest) -> None:
    """Refuse to overwrite a finished search; an unfinished one is continued."""
    from fpplab.optimisation.run import journal_paths, plan_paths

    out, scope = request.out, request.scope
    if scope is not SearchScope.PARETO:
        need_suffix(out, ".yaml")
    elif out.exists() and not out.is_dir():
        raise ConfigError(f"{out}: is a file; `pareto` leaves a folder of plans")
    plans, journals = plan_paths(scope, out), journal_paths(scope, out)
    has_journal = any(path.is_file() for path in journals)
    unfinished = has_journal and not request.page.is_file()  # the report is written last
    if plans and not (request.force or unfinished):
        raise ConfigError(f"{plans[0]}: exists already; name another output, or add --force to replace it")
    if request.force:
        for path in (*plans, *journals):
            path.unlink(missing_ok=True)


def _confirm_with_other_seeds(
    request: OptimisationRequest, search: SearchResult, observer: Observer
) -> tuple[ConfirmedPlan, ...]:
    from fpplab.optimisation.confirm import confirm_result
    from fpplab.optimisation.run import work_folder

    if not (request.confirm and search.plans):
        return ()
    with observer.stage("Confirming") as progress:
        folder = work_folder(request.out) / "confirm"
        return confirm_result(request.confirm, search, folder, progress)


def compare_before_and_after(rig: str, search: SearchResult) -> BeforeAndAfter:
    """Measure every artefact once more on the search's rig, with the first and the best plan."""
    from fpplab.optimisation.measuring import RigEvaluator
    from fpplab.results.provenance import rig_provenance
    from fpplab.results.search import BeforeAndAfter

    start, optimum = search.start.candidate, search.optimum.candidate
    candidates = {trial.candidate.stage_mm: trial.candidate for trial in search.trials}
    with closing(RigEvaluator(rig, search.study)) as evaluator:
        seed = search.study.seeds[0]
        artefacts = {
            name: (_measure(evaluator, name, start, seed), _measure(evaluator, name, optimum, seed))
            for name in search.study.artefacts
        }
        angles = {
            mm: evaluator.triangulation_angle_deg(candidate)
            for mm, candidate in candidates.items()
            if mm is not None
        }
        described, origin = evaluator.described()
        provenance = rig_provenance(described, origin, search.study.start)
    return BeforeAndAfter(artefacts, angles, {"rig": provenance})


def _measure(evaluator: RigEvaluator, name: str, candidate: Candidate, seed: int) -> MeasuredArtefact:
    from fpplab.results.search import MeasuredArtefact

    cloud, comparison = evaluator.compare(name, candidate, seed)
    return MeasuredArtefact(cloud, comparison)
