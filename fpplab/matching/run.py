"""The whole of a matching: from recorded sessions to a twin that runs in every command, and its figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from fpplab.calibration.model import Calibration
from fpplab.characterisation import Characterisation
from fpplab.core.errors import ConfigError
from fpplab.core.progress import Progress, ignore, no_progress
from fpplab.devices.rig import Rig
from fpplab.matching import plausibility
from fpplab.matching.evaluation import TwinEvaluation, evaluate
from fpplab.matching.gamma import GammaMatch, match_gamma
from fpplab.matching.judgement import ArtefactJudgement, judge_artefacts
from fpplab.matching.loss import Weights
from fpplab.matching.match import EpochObserver, Limits, Matched, match_twin
from fpplab.matching.record import PLAIN, MatchingRecord
from fpplab.matching.reference import Reference
from fpplab.patterns.response import Response
from fpplab.pipeline import characterise_sessions
from fpplab.sessions.session import Session
from fpplab.simulation.matchable import Matchable, Parameters, Twin
from fpplab.targets import Target


def there(nominal: Parameters) -> Parameters:
    """Begin where the bench's own characterisation is."""
    return nominal


@dataclass(frozen=True)
class MatchingRequest:
    """How to match.

    board, card: what the twin's fixture calls them. response: the bench's. scans: by item, for the judgement.
    start: where to begin, given the nominal twin in the geometry that the bench found of itself.
    """

    board: str = "board"
    card: str = "grey_card"
    response: Response | None = None
    scans: Mapping[str, Session] = field(default_factory=dict)
    weights: Weights = field(default_factory=Weights)
    limits: Limits = field(default_factory=Limits)
    start: Callable[[Parameters], Parameters] = there


@dataclass(frozen=True)
class Row:
    """One row of the paper's table: whether geometry and light were refined, whether the response was."""

    refined: bool
    gamma: bool
    loss: dict[str, float]


@dataclass(frozen=True, eq=False)
class MatchingResult:
    """Everything a matching found.

    start: where it began, with the response matched. nominal: the same, but lit as the twin's own file says.
    before: of the nominal. rows: the paper's table; those with the response only where it was measured.
    """

    bench: Reference
    nominal: Parameters
    start: Parameters
    gamma: GammaMatch | None
    before: TwinEvaluation
    matched: Matched
    rows: tuple[Row, ...]
    judgements: tuple[ArtefactJudgement, ...]

    def summary(self) -> dict[str, Any]:
        """The figures for a machine to read, as the command line prints them."""
        loss, found = self.matched.final.loss.summary(), self.matched.parameters
        light = {name: getattr(found, name) for name in PLAIN}
        return {
            **loss,
            "epochs": len(self.matched.epochs) - 1,
            "ended": self.matched.ended,
            "gamma": self.gamma.summary() if self.gamma else None,
            "rows": [{"refined": r.refined, "with_gamma": r.gamma, **r.loss} for r in self.rows],
            "explained": self.matched.explained,
            "unexplained_levels": self.matched.unexplained,
            "parameters": {**light, "response": found.response.model_dump()},
            "baseline_mm": found.calibration.baseline_mm,
            "poses": self.by_pose(),
            "artefacts": [one.summary() for one in self.judgements],
        }

    def by_pose(self) -> list[dict[str, Any]]:
        """Of every pose its name, and `ssim`, `ssim_board`, `epsilon_d_px` with `_before` and `_after`."""
        before, after = (one.of_poses(self.bench) for one in (self.before, self.matched.final))
        return [
            {
                "pose": name,
                **{f"{key}_before": value for key, value in figures.items()},
                **{f"{key}_after": value for key, value in after[name].items()},
            }
            for name, figures in before.items()
        ]


def twin_of(rig: Rig, board: str) -> Twin:
    """The twin behind an open rig. Raises `ConfigError` when it has none."""
    if not isinstance(rig.simulation, Matchable):
        raise ConfigError(
            "--twin: its bench cannot be matched, for it is no simulation; name a rig such as rig_twin"
        )
    return rig.simulation.twin(board)


def match_sessions(
    twin: Twin,
    sessions: Sequence[Session],
    target: Target,
    folder: Path,
    wanted: MatchingRequest,
    *,
    progress: Progress = no_progress,
    observe: EpochObserver = ignore,
) -> MatchingResult:
    """Match the twin to recorded board sessions, and save it in `folder`.

    Goes on where a record in `folder` ends. Raises `ConfigError` and `CalibrationError` that say what does
    not fit when the twin is not the bench's.
    """
    plausibility.check_devices(twin, sessions[0])
    plausibility.check_board(twin, target, "--target")
    nominal = twin.parameters
    found = characterise_sessions(sessions, target, lambda share: progress(0.1 * share))
    plausibility.check_near(found.calibration, nominal.calibration)
    bench = Reference.of(sessions, target, found, wanted.response)
    nominal = wanted.start(in_place(nominal, found))
    twin.become(nominal)
    gamma = None
    if wanted.response is not None:
        gamma = match_gamma(twin, wanted.response, wanted.card, bench.settings)
    start = twin.parameters
    matched = match_twin(
        bench,
        twin,
        start,
        MatchingRecord(folder),
        wanted.weights,
        wanted.limits,
        progress=lambda share: progress(0.1 + 0.7 * share),
        observe=observe,
    )
    plausibility.check_alike(matched.final.loss, matched.unexplained)
    if matched.focused:
        plausibility.check_sharpness(bench, twin)
    twin.become(nominal)
    before = evaluate(bench, twin, wanted.weights)
    rows = _table(bench, twin, wanted.weights, nominal, before, matched, gamma is not None)
    twin.become(matched.parameters)
    twin.save(folder)
    own = matched.final.characterisation
    assert own is not None  # the last evaluation characterises
    judgements = judge_artefacts(
        twin,
        wanted.scans,
        found.calibration,
        own.calibration,
        lambda share: progress(0.85 + 0.15 * share),
    )
    return MatchingResult(bench, nominal, start, gamma, before, matched, rows, tuple(judgements))


def in_place(nominal: Parameters, found: Characterisation) -> Parameters:
    """The nominal twin in the geometry that the bench found of itself."""
    known = found.calibration
    calibration = Calibration(known.camera, known.projector, known.T_projector_camera, {})
    return replace(nominal, calibration=calibration, poses=found.poses)


def _table(
    bench: Reference,
    twin: Twin,
    weights: Weights,
    nominal: Parameters,
    before: TwinEvaluation,
    matched: Matched,
    gamma: bool,
) -> tuple[Row, ...]:
    """The paper's table: before and after, without and with the response."""
    first, after = Row(False, False, before.loss.summary()), matched.final.loss.summary()
    if not gamma:
        return first, Row(True, False, after)
    twin.become(replace(matched.parameters, response=nominal.response, white=nominal.white))
    return (
        first,
        Row(False, True, matched.epochs[0].loss),
        Row(True, False, evaluate(bench, twin, weights).loss.summary()),
        Row(True, True, after),
    )
