"""What a matching found: the twin before and after, and how both compare with the bench."""

from dataclasses import dataclass
from typing import Any

from fpplab.diagnosis import FaultCause, Finding
from sim.matching.evaluation import TwinEvaluation
from sim.matching.light.gamma import GammaMatch
from sim.matching.match import MatchedTwin
from sim.matching.reference import Reference
from sim.matching.scene.appearance import AppearanceTrial
from sim.matching.scene.artefacts import ArtefactComparison
from sim.matching.scene.surface import SurfaceMatch
from sim.parameters import TwinParameters


@dataclass(frozen=True)
class AblationRow:
    """One row of the paper's table: the loss with and without each part of the matching."""

    refined: bool  # whether geometry and light were refined
    gamma: bool  # whether the response was matched
    loss: dict[str, float]  # as `Loss.summary` gives it


@dataclass(frozen=True, eq=False)
class MatchingFigures:
    """Everything that a matching found, before anybody judges it."""

    reference: Reference  # what the twin was matched to
    nominal: TwinParameters  # the start, with light and response of the twin's own file
    start: TwinParameters  # where the matching began, with the response matched
    gamma: GammaMatch | None  # where a response was given
    before: TwinEvaluation  # of `nominal`
    matched: MatchedTwin  # the result, with its epochs
    final: TwinEvaluation  # of the result, with what it shows of the board's sheet and its surroundings
    rows: tuple[AblationRow, ...]  # the paper's table; rows with the response only where it was measured
    artefacts: tuple[ArtefactComparison, ...]  # one for each recorded scan
    accepted: frozenset[FaultCause] = frozenset()  # causes for which nothing was refused
    noted: tuple[str, ...] = ()  # what was found and accepted before the matching
    card_measured: bool = False  # whether the pose of the grey card was measured on the bench
    late: tuple[Finding, ...] = ()  # what only the matched twin shows
    surfaces: tuple[SurfaceMatch, ...] = ()  # one for each part whose surface was matched
    appearance: AppearanceTrial | None = None

    def by_pose(self) -> list[dict[str, Any]]:
        before, after = (evaluation.by_pose_name(self.reference) for evaluation in (self.before, self.final))
        return [
            {
                "pose": name,
                **{f"{key}_before": value for key, value in figures.items()},
                **{f"{key}_after": value for key, value in after[name].items()},
            }
            for name, figures in before.items()
        ]
