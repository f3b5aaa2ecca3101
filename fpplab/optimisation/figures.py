"""Figures of a candidate: what is measured once per artefact and seed is averaged over both."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from fpplab.optimisation.candidate import Candidate, Point, Score, candidate_fields


@dataclass(frozen=True)
class CandidateFigures:
    """Figures of a candidate: means over artefacts and seeds, unless stated otherwise."""

    surface_smcd_um: float  # symmetric mean distance between points and true surface in µm
    smcd_spread_um: float | None  # standard deviation over the seeds of its mean over artefacts, in µm
    worst_smcd_um: float  # the same distance for the worst seed, in µm
    worst_artefact_um: float  # the same distance for the worst artefact, in µm
    surface_rms_um: float  # root mean square distance of the points from the true surface in µm
    smcd_um: float  # symmetric mean Chamfer distance between points and sampled surface in µm
    smcd_floor_um: float  # what a perfect measurement would have for `smcd_um`, in µm
    completeness: float  # share of the surface that was measured, 0 … 1
    wrong_orders: float  # share of points with a wrong fringe order, 0 … 1
    outliers: float  # share of points that the filter removed, 0 … 1
    images: int  # images that a measurement takes
    seconds: float  # acquisition time of a measurement

    @classmethod
    def of(cls, scores: Sequence[Score]) -> CandidateFigures:
        seeds, artefacts = (list(_mean_scores_by(scores, key).values()) for key in ("seed", "artefact"))
        means = [f.name for f in fields(cls) if f.name != "images" and hasattr(scores[0], f.name)]
        return cls(
            smcd_spread_um=float(np.std(seeds, ddof=1)) if len(seeds) > 1 else None,
            worst_smcd_um=max(seeds),
            worst_artefact_um=max(artefacts),
            images=scores[0].images,
            **{name: float(np.mean([getattr(score, name) for score in scores])) for name in means},
        )


def seed_means(scores: Sequence[Score]) -> Mapping[int, float]:
    return _mean_scores_by(scores, "seed")


def _mean_scores_by(scores: Sequence[Score], key: str) -> Mapping[Any, float]:
    grouped = defaultdict(list)
    for score in scores:
        grouped[getattr(score, key)].append(score.surface_smcd_um)
    return {name: float(np.mean(values)) for name, values in grouped.items()}


@dataclass(frozen=True)
class MeasuredCandidate:
    """A candidate with its scores, or the reason why it has none."""

    point: Point  # point of the search space
    candidate: Candidate  # what the point stands for
    scores: tuple[Score, ...] = ()  # of every artefact with every seed; empty if not measured
    refused: str | None = None  # why the rig or the study does not allow it
    failed: str | None = None  # why the measurement failed

    @cached_property
    def figures(self) -> CandidateFigures:
        return CandidateFigures.of(self.scores)

    @property
    def measured(self) -> bool:
        return self.refused is None and self.failed is None

    def summary(self) -> dict[str, Any]:
        figures = asdict(self.figures) if self.measured else {"failed": self.refused or self.failed}
        return {**candidate_fields(self.candidate), **figures}
