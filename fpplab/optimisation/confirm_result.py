"""Confirms the plans that a search has found by measuring on a rig, the same or another."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fpplab.core.progress import Progress, no_progress
from fpplab.devices.rig import Rig
from fpplab.optimisation.arrangement import with_calibrations
from fpplab.optimisation.confirm import Confirmation, compare_plans
from fpplab.optimisation.limits import RigLimits
from fpplab.optimisation.problem import SearchProblem
from fpplab.optimisation.result import SearchResult
from fpplab.patterns.plan import Plan


@dataclass(frozen=True, eq=False)
class ConfirmedPlan:
    """A plan that was found, compared with the plan of the start on a rig."""

    rig: str  # name in the rig's file
    plan: Path  # file of the plan
    images: int  # images that the plan takes
    confirmation: Confirmation  # figures of both plans, and the gain

    def summary(self) -> dict[str, Any]:
        return {"rig": self.rig, "plan": str(self.plan), "images": self.images, **self.confirmation.summary()}


def check_confirmable(rig: str, problem: SearchProblem, source: str) -> None:
    with Rig.load(rig) as opened:
        RigLimits.of(opened).check_items(problem.artefacts, source)


def confirm_result(
    rig: str, result: SearchResult, folder: Path, progress: Progress = no_progress
) -> tuple[ConfirmedPlan, ...]:
    # Of a front the first, the middle and the last plan are measured. The rig is characterised unless it is
    # the one that was searched on.
    chosen = sorted({0, len(result.plans) // 2, len(result.plans) - 1})
    trials = [(result.plans[i], result.planned[i]) for i in chosen]
    study = result.study
    with Rig.load(rig) as opened:
        limits = RigLimits.of(opened)
        for path, trial in trials:
            limits.check(trial.candidate, str(path))
        if limits.name != result.rig:
            stage_positions = [mm for _, trial in trials if (mm := trial.candidate.stage_mm) is not None]
            study = with_calibrations(opened, study, folder, progress, stage_positions)
    return tuple(
        ConfirmedPlan(
            rig=limits.name,
            plan=path,
            images=trial.candidate.images,
            confirmation=compare_plans(rig, study, study.start, Plan.load(path), progress=progress),
        )
        for path, trial in trials
    )
