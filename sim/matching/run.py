"""A complete matching: from recorded sessions to a twin that runs in every command, and its figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from fpplab.calibration.model import Calibration
from fpplab.characterisation import Characterisation
from fpplab.core.errors import ConfigError
from fpplab.core.progress import Progress, Say, ignore, no_progress
from fpplab.devices.rig import Rig
from fpplab.diagnosis import Diagnosis, FaultCause, Finding
from fpplab.patterns.response import Response
from fpplab.pipeline import characterise_sessions
from fpplab.sessions.session import Session
from fpplab.targets import Target
from sim.bench import VirtualBench
from sim.matching.evaluation import TwinEvaluation, evaluate
from sim.matching.geometry.card import card_pose
from sim.matching.judging import plausibility
from sim.matching.judging.discrepancy import discrepancy_of
from sim.matching.judging.verdict import accepted_findings, diagnose_matching
from sim.matching.light.gamma import GammaMatch, match_gamma, with_level_of_card
from sim.matching.loss import Weights
from sim.matching.match import EpochObserver, MatchedTwin, MatchingLimits, match_twin
from sim.matching.parts import check_scans, fit_scans, match_surfaces
from sim.matching.record import PLAIN, MatchingRecord
from sim.matching.reference import Reference
from sim.matching.refusal import Refusals
from sim.matching.scene.appearance import AppearanceTrial, match_appearance
from sim.matching.scene.artefacts import ArtefactComparison, compare_artefacts
from sim.matching.scene.surface import SurfaceMatch
from sim.parameters import TwinParameters
from sim.twin import Twin


def unchanged_start(nominal: TwinParameters) -> TwinParameters:
    """Start from the nominal twin in the reference's geometry, as `MatchingRequest.start` does by default."""
    return nominal


@dataclass(frozen=True)
class MatchingRequest:
    """What to match, and how."""

    board: str = "board"  # the board, as the twin's fixture calls it
    card: str = "grey_card"  # the grey card, as the twin's fixture calls it
    response: Response | None = None  # measured on the bench
    scans: Mapping[str, Session] = field(default_factory=dict)  # recorded scans of artefacts by name
    surfaces: Mapping[str, Session] = field(default_factory=dict)  # recorded scans of parts by name
    weights: Weights = field(default_factory=Weights)  # of the loss
    limits: MatchingLimits = field(default_factory=MatchingLimits)  # when to stop
    accepted: frozenset[FaultCause] = frozenset()  # causes for which the matching is not refused
    card_scan: Session | None = None  # the bench's scan of the grey card as it stood for the response
    start: Callable[[TwinParameters], TwinParameters] = unchanged_start  # gives the parameters to start from


@dataclass(frozen=True)
class AblationRow:
    """One row of the paper's table: the loss with and without each part of the matching."""

    refined: bool  # whether geometry and light were refined
    gamma: bool  # whether the response was matched
    loss: dict[str, float]  # as `Loss.summary` gives it


@dataclass(frozen=True, eq=False)
class MatchingResult:
    """Everything that a matching found."""

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

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """Whether to believe the twin; looks at the frames of the poses."""
        return diagnose_matching(self)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was accepted although the twin would have been refused for it; stays with the twin."""
        return (*self.noted, *accepted_findings(self))

    def summary(self) -> dict[str, Any]:
        """Give the figures as plain data, as the command line prints them."""
        loss, found = self.final.loss.summary(), self.matched.parameters
        light = {name: getattr(found, name) for name in PLAIN}
        return {
            **self.diagnosis.summary(),
            **loss,
            "epochs": len(self.matched.epochs) - 1,
            "ended": self.matched.ended,
            "gamma": self.gamma.summary() if self.gamma else None,
            "rows": [{"refined": r.refined, "with_gamma": r.gamma, **r.loss} for r in self.rows],
            "explained": self.matched.explained,
            "unexplained_levels": self.matched.unexplained,
            "parameters": {**light, "response": found.response.model_dump()},
            "sigma": dict(found.sigma),
            "notes": list(self.notes),
            "appearance": self.appearance.summary() if self.appearance else None,
            "baseline_mm": found.calibration.baseline_mm,
            "poses": self.by_pose(),
            "artefacts": [one.summary() for one in self.artefacts],
            "surfaces": [one.summary() for one in self.surfaces],
        }

    def by_pose(self) -> list[dict[str, Any]]:
        """Give the figures of every pose before and after the matching."""
        before, after = (one.by_pose_name(self.reference) for one in (self.before, self.final))
        return [
            {
                "pose": name,
                **{f"{key}_before": value for key, value in figures.items()},
                **{f"{key}_after": value for key, value in after[name].items()},
            }
            for name, figures in before.items()
        ]


def twin_of(rig: Rig, board: str) -> Twin:
    """Give the twin of an open rig."""
    if not isinstance(rig.simulation, VirtualBench):
        raise ConfigError(
            "--twin: the rig has no simulation that can be matched; name a rig such as rig_twin"
        )
    return rig.simulation.twin(board)


def match_sessions(
    twin: Twin,
    sessions: Sequence[Session],
    target: Target,
    folder: Path,
    request: MatchingRequest,
    *,
    progress: Progress = no_progress,
    observe: EpochObserver = ignore,
    tell: Say = ignore,
    prepared: Callable[[Reference], object] = ignore,
) -> MatchingResult:
    """Match the twin to recorded sessions of a board, and save it unless nobody should use it.

    Continues where a record in `folder` ends. The twin is left with the matched parameters.
    """
    refusals = Refusals(request.accepted)
    _check_inputs(twin, sessions, target, request)
    nominal = twin.parameters
    tell("characterising the bench")
    found = characterise_sessions(sessions, target, lambda share: progress(0.1 * share))
    plausibility.check_geometry(found.calibration, nominal.calibration, refusals)
    if request.response is not None:
        plausibility.check_response(request.response, sessions, refusals)
    tell("comparing the scans with the artefacts' shapes")
    scans, parts = (
        fit_scans(twin, of, found.calibration, refusals) for of in (request.scans, request.surfaces)
    )
    reference = Reference.of(sessions, target, found, request.response)
    prepared(reference)
    nominal = request.start(_placed(with_reference_geometry(nominal, found), request, found, twin))
    twin.become(nominal)
    gamma = None
    if request.response is not None:
        gamma = match_gamma(twin, request.response, request.card, reference.settings)
    start = twin.parameters
    matched = match_twin(
        reference,
        twin,
        start,
        MatchingRecord(folder),
        request.weights,
        request.limits,
        [*scans, *parts],
        progress=lambda share: progress(0.1 + 0.7 * share),
        observe=observe,
        tell=tell,
    )
    if request.response is not None:
        levelled = with_level_of_card(twin, request.response, request.card, reference.settings)
        matched = replace(matched, parameters=levelled)
    late = plausibility.similarity_finding(matched.ssim_board, matched.unexplained)
    blurred = plausibility.sharpness_finding(reference, twin) if matched.refined_focus else None
    twin.become(nominal)
    tell("comparing before and after")
    before = evaluate(reference, twin, request.weights, progress=lambda share: progress(0.8 + 0.04 * share))
    twin.become(matched.parameters)
    surfaces = match_surfaces(twin, parts, tell)
    complete = twin.parameters
    tell("matching the board's sheet and the surroundings")
    appearance = match_appearance(reference, twin)
    tell("judging the result")
    # Only now: grain of the print moves what is found of the board, on the twin as on the bench.
    final = evaluate(reference, twin, request.weights, progress=lambda share: progress(0.84 + 0.04 * share))
    own = final.characterisation
    assert own is not None  # it was not told the twin's reprojection error
    artefacts = compare_artefacts(twin, scans, own.calibration, lambda share: progress(0.88 + 0.12 * share))
    rows = _table(reference, twin, request.weights, nominal, before, matched, final, gamma is not None)
    twin.become(complete)
    result = MatchingResult(
        reference,
        nominal,
        start,
        gamma,
        before,
        matched,
        final,
        rows,
        tuple(artefacts),
        request.accepted,
        tuple(refusals.notes),
        request.card_scan is not None,
        tuple(one for one in (late, blurred) if one is not None),
        tuple(surfaces),
        appearance,
    )
    if not result.diagnosis.is_useless:
        tell("comparing noise and scans for the intervals of predictions")
        discrepancy_of(reference, twin, [*scans, *parts]).save(folder)
        twin.save(folder, result.notes)
    return result


def _check_inputs(twin: Twin, sessions: Sequence[Session], target: Target, request: MatchingRequest) -> None:
    """Refuse what can be told before any work: other devices, another board, items that are not there."""
    for session in [*sessions, request.card_scan] if request.card_scan else sessions:
        plausibility.check_devices(twin, session)
    plausibility.check_board(twin, target, "--target")
    for scans in (request.scans, request.surfaces):
        check_scans(twin, scans)
    if request.response is not None:
        twin.pose_of(request.card)


def _placed(
    nominal: TwinParameters, request: MatchingRequest, found: Characterisation, twin: Twin
) -> TwinParameters:
    """Put the grey card where the bench's scan of it shows it."""
    if request.card_scan is None:
        return nominal
    pose = card_pose(request.card_scan, found.calibration, twin.pose_of(request.card))
    return replace(nominal, placed={**nominal.placed, request.card: pose})


def with_reference_geometry(nominal: TwinParameters, found: Characterisation) -> TwinParameters:
    """Put the twin into the geometry that the bench's own characterisation found."""
    known = found.calibration
    calibration = Calibration(known.camera, known.projector, known.T_projector_camera, {}, known.uncertainty)
    return replace(nominal, calibration=calibration, poses=found.poses)


def _table(
    reference: Reference,
    twin: Twin,
    weights: Weights,
    nominal: TwinParameters,
    before: TwinEvaluation,
    matched: MatchedTwin,
    final: TwinEvaluation,
    gamma: bool,
) -> tuple[AblationRow, ...]:
    """Fill the paper's table: before and after, without and with the response."""
    first, after = AblationRow(False, False, before.loss.summary()), final.loss.summary()
    if not gamma:
        return first, AblationRow(True, False, after)
    twin.become(replace(matched.parameters, response=nominal.response, white=nominal.white))
    return (
        first,
        AblationRow(False, True, matched.epochs[0].loss),
        AblationRow(True, False, evaluate(reference, twin, weights).loss.summary()),
        AblationRow(True, True, after),
    )
