"""Compares two plans on a rig by measuring with both in turn, and states the gain with its uncertainty."""

from collections import defaultdict
from dataclasses import asdict, dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError
from fpplab.core.progress import Progress, no_progress
from fpplab.devices.rig import Rig
from fpplab.optimisation.arrangement import StageCalibrations, with_calibrations
from fpplab.optimisation.candidate import Candidate
from fpplab.optimisation.limits import RigLimits
from fpplab.optimisation.measuring import RigEvaluator
from fpplab.optimisation.problem import SearchProblem
from fpplab.optimisation.result import SearchResult
from fpplab.optimisation.scoring import ArtefactFigures
from fpplab.patterns.plan import Plan


@dataclass(frozen=True)
class ConfirmationLimits:
    """Numbers of measurements, samples and draws of a confirmation."""

    repeats: int = 5  # measurements of each artefact with each plan, by default (chosen)
    samples: int = 100_000  # pixels, and points of the true surface, that are compared (chosen)
    calibration_draws: int = 8  # drawn from the covariance (derived: its part is then known to a quarter)
    first_seed: int = 1_000_000  # seed of the first repeat (chosen beyond all seeds that a search uses)


LIMITS = ConfirmationLimits()


RepeatedFigures = dict[str, tuple[ArtefactFigures, ...]]  # figures of every repeat by artefact


@dataclass(frozen=True)
class Confirmation:
    """The figures of two plans on one rig."""

    before: RepeatedFigures  # every repeat of every artefact with the first plan
    after: RepeatedFigures  # the same with the second plan, in the same order
    by_calibration: float  # standard uncertainty of the gain due to the calibration

    @property
    def gain(self) -> float:
        """Relative decrease of the mean surface SMCD over artefacts and repeats: 0.5 is half the distance."""
        return 1.0 - float(_smcd(self.after).mean() / _smcd(self.before).mean())

    @property
    def by_repeat(self) -> float:
        """Standard uncertainty of the gain due to what differs from repeat to repeat."""
        gains = 1.0 - _smcd(self.after).mean(axis=0) / _smcd(self.before).mean(axis=0)
        return float(np.std(gains, ddof=1) / np.sqrt(len(gains)))

    @property
    def by_sample(self) -> float:
        """Standard uncertainty of the gain due to the sample of points, which is the same for all repeats."""
        relative = [
            np.sqrt(
                np.mean([repeats[0].surface_spread_um ** 2 for repeats in figures.values()]) / len(figures)
            )
            / _smcd(figures).mean()
            for figures in (self.before, self.after)
        ]
        return float((1.0 - self.gain) * np.hypot(*relative))

    @property
    def uncertainty(self) -> float:
        return float(np.sqrt(self.by_repeat**2 + self.by_sample**2 + self.by_calibration**2))

    def summary(self) -> dict[str, Any]:
        return {
            "gain": self.gain,
            "uncertainty": self.uncertainty,
            "by_repeat": self.by_repeat,
            "by_sample": self.by_sample,
            "by_calibration": self.by_calibration,
            "before": _described(self.before),
            "after": _described(self.after),
        }


def _smcd(by_artefact: RepeatedFigures) -> Floats:
    return np.array([[figures.surface_smcd_um for figures in repeats] for repeats in by_artefact.values()])


def _described(by_artefact: RepeatedFigures) -> dict[str, Any]:
    return {
        "surface_smcd_um": float(_smcd(by_artefact).mean()),
        "artefacts": {
            name: {
                key: float(np.mean([asdict(figures)[key] for figures in repeats]))
                for key in asdict(repeats[0])
            }
            for name, repeats in by_artefact.items()
        },
    }


def compare_plans(
    rig: str,
    problem: SearchProblem,
    before: Plan,
    after: Plan,
    repeats: int = LIMITS.repeats,
    progress: Progress = no_progress,
) -> Confirmation:
    if repeats < 2:
        raise ConfigError(f"--repeats: {repeats}: at least 2, or nothing is known of the uncertainty")
    _check_comparable(before, after)
    evaluator = RigEvaluator(rig, problem.model_copy(update={"start": before}), LIMITS.samples)
    plans = Candidate.of(before), Candidate.of(after)
    by_plan: dict[tuple[int, str], list[ArtefactFigures]] = defaultdict(list)
    varied: dict[int, list[list[float]]] = defaultdict(list)
    try:
        others = _sampled_calibrations(evaluator.calibrations)
        turns = list(product(problem.artefacts, range(repeats), (0, 1)))
        for done, (name, repeat, which) in enumerate(turns):
            arguments = name, plans[which], LIMITS.first_seed + repeat
            by_plan[which, name].append(evaluator.figures(*arguments))
            if repeat == 0:  # while its frames are in memory
                with_drawn = (evaluator.figures(*arguments, other) for other in others)
                varied[which].append([figures.surface_smcd_um for figures in with_drawn])
            progress((done + 1) / len(turns))
    finally:
        evaluator.close()
    old, new = ({name: tuple(by_plan[which, name]) for name in problem.artefacts} for which in (0, 1))
    gains = 1.0 - np.mean(varied[1], axis=0) / np.mean(varied[0], axis=0)
    return Confirmation(old, new, float(np.std(gains, ddof=1)) if others else 0.0)


def _sampled_calibrations(calibrations: StageCalibrations) -> list[StageCalibrations]:
    random = np.random.default_rng(0)
    return (
        []
        if calibrations.is_exact
        else [calibrations.sample(random) for _ in range(LIMITS.calibration_draws)]
    )


def _check_comparable(before: Plan, after: Plan) -> None:
    other = Candidate.of(after).plan(before)
    for name in type(before).model_fields:
        if name != "fringes" and getattr(other, name) != getattr(after, name):
            raise ConfigError(
                f"the two plans differ in '{name}': they may in fringes, exposure_s and stage_mm alone"
            )


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
