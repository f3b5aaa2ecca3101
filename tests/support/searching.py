"""Rigs made of a formula: what a search must find is known exactly."""

from __future__ import annotations

import os
import signal
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fpplab.core import config
from fpplab.core.errors import DataError
from fpplab.optimisation.candidate import Candidate, Score
from fpplab.optimisation.candidate_runner import CandidateRunner
from fpplab.optimisation.limits import RigLimits
from fpplab.optimisation.scheduling import InProcessWorkers
from fpplab.optimisation.space import SearchSpace
from fpplab.optimisation.storage import Journal
from fpplab.optimisation.study import Study

LIMITS = RigLimits(
    name="Formula",
    size=(912, 1140),
    max_patterns=1000,
    exposure_s=(0.001, 1.0),
    bit_depths={1: 0.000235, 4: 0.0017, 8: 0.008333},
    dead_time_s=0.0,
    stage_mm=(-60.0, 60.0),
    can_turn_projector=True,
    items=frozenset({"ball", "cube"}),
)
FRINGES = [{"axis": "x", "stripes": s, "steps": 12} for s in (1, 8, 64)]
PLAIN: dict[str, Any] = {
    "name": "Test",
    "artefacts": ["ball", "cube"],
    "start": {"fringes": FRINGES, "stage_mm": 0.0},
    "space": {"stripes": [None, [2, 32], [12, 228]]},
    "objectives": ["surface_smcd_um"],
    "seeds": [1, 2],
    "method": {"kind": "coordinate"},
    "budget": 2000,
}

PHASES: dict[str, Any] = {
    "space": {"steps": [[3, 12], [3, 12], [3, 16]]},
    "objectives": ["images"],
    "constraints": {"smcd_of_start": 1.0},
}
FRONT: dict[str, Any] = {
    "space": {
        "steps": [[3, 12], [3, 12], [3, 15]],
        "stripes": [None, [2, 32], [12, 228]],
        "stage_mm": [-60, 60],
    },
    "start": {"fringes": [{**fringe, "steps": 7} for fringe in FRINGES], "stage_mm": 0.0},
    "objectives": ["surface_smcd_um", "images"],
    "method": {"kind": "nsga2", "population": 12},
    "constraints": {"images": 21},
    "budget": 600,
}
GRAY: dict[str, Any] = {
    "fringes": [
        {"kind": "gray", "axis": "x", "bits": 6, "cell_px": 19.0},
        {"axis": "x", "stripes": 48, "steps": 4},
    ],
    "ranges": [{"bits": [5, 7], "cell_px": [8, 38]}, {"steps": [3, 6]}],
}


def study(**changes: Any) -> Study:
    """A study like `PLAIN`, with changes."""
    return config.validate({**PLAIN, **changes}, Study, "study.yaml")


@dataclass(frozen=True)
class Formula:
    """Opens an evaluator whose distance is least at `best_stripes` of the finest set and `best_stage_mm`.

    The phase noise of a set is 1/sqrt(steps). Coarse noise beyond `throw` of a finer period throws orders.
    noise_um: of every seed, the same for all candidates. scatter_um: of every candidate and seed.
    log: a file that counts measurements.
    dies_once: the first process to see a candidate of so many images is killed; the file remembers it.
    fails_at: so many images, at which nothing can be measured.
    """

    best_stripes: float = 100.0
    best_stage_mm: float = 20.0
    throw: float = 1.4
    noise_um: float = 0.0
    scatter_um: float = 0.0
    log: Path | None = None
    dies_once: Path | None = None
    fails_at: int = 0

    def __call__(self) -> Calculated:
        return Calculated(self)


@dataclass
class Calculated:
    """An evaluator without a rig."""

    formula: Formula
    closed: bool = False

    def measure(self, candidate: Candidate, seed: int) -> tuple[Score, ...]:
        formula = self.formula
        if formula.log is not None:
            with formula.log.open("a") as stream:
                stream.write(f"{candidate.images} {seed}\n")
        if formula.dies_once is not None and not formula.dies_once.exists():
            formula.dies_once.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if candidate.images == formula.fails_at:
            raise DataError("no pixel could be measured")
        return tuple(self._score(candidate, seed, name) for name in ("ball", "cube"))

    def close(self) -> None:
        self.closed = True

    def _score(self, candidate: Candidate, seed: int, artefact: str) -> Score:
        formula, finest = self.formula, candidate.fringes[-1]
        wrong = self._wrong(candidate)
        valley = np.log(finest.stripes / formula.best_stripes) ** 2
        moved = ((candidate.stage_mm or 0.0) - formula.best_stage_mm) / 60.0
        distance = 10.0 + 30.0 * valley + 40.0 / np.sqrt(finest.steps) + 20.0 * moved**2 + 2000.0 * wrong
        distance += formula.noise_um * np.random.default_rng(seed).normal() + 5.0 * (artefact == "cube")
        own = [seed, round(1e3 * finest.stripes), candidate.images]
        distance += formula.scatter_um * np.random.default_rng(own).normal()
        return Score(
            artefact=artefact,
            seed=seed,
            images=candidate.images,
            points=1000,
            surface_smcd_um=float(distance),
            smcd_um=float(distance + 50.0),
            smcd_floor_um=50.0,
            surface_rms_um=float(1.3 * distance),
            completeness=0.99 - 0.5 * wrong,
            wrong_orders=wrong,
            outliers=0.01,
            seconds=candidate.images * candidate.exposure_s,
        )

    def _wrong(self, candidate: Candidate) -> float:
        """A share that is exactly 0 where every step from set to set is small enough for its noise."""
        pairs = zip(candidate.fringes[:-1], candidate.fringes[1:], strict=True)
        excess = [f.stripes / c.stripes / np.sqrt(c.steps) / (4 * self.formula.throw) - 1.0 for c, f in pairs]
        return float(np.clip(max([*excess, 0.0]), 0.0, 1.0))


def search(runner: CandidateRunner) -> str:
    """Search with the method of the study that a runner was made for."""
    problem = runner.space.problem
    assert isinstance(problem, Study)
    return problem.method.search(runner)


def runner_of(
    folder: Path, formula: Formula | None = None, limits: RigLimits = LIMITS, **changes: Any
) -> CandidateRunner:
    """A runner in this process."""
    wanted = study(**changes)
    space = SearchSpace.of(wanted, limits, "study.yaml")
    return CandidateRunner(
        space, InProcessWorkers(formula or Formula()), Journal(folder / "study.jsonl", wanted, {})
    )


def with_stage(travel: tuple[float, float] | None) -> RigLimits:
    """Limits of a rig whose stage travels otherwise."""
    return replace(LIMITS, stage_mm=travel)


def scores_of(table: dict[tuple[str, int], float], **others: Any) -> tuple[Score, ...]:
    """Scores of one candidate by artefact and seed, with changes."""
    plain: dict[str, Any] = {
        "images": 36, "points": 9, "smcd_um": 80.0, "smcd_floor_um": 50.0, "surface_rms_um": 1.0,
        "completeness": 0.9, "wrong_orders": 0.0, "outliers": 0.0, "seconds": 1.0,
    }  # fmt: skip
    return tuple(
        Score(artefact=name, seed=seed, surface_smcd_um=um, **{**plain, **others})
        for (name, seed), um in table.items()
    )
