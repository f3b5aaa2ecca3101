"""A complete matching: from recorded sessions to a twin that runs in every command, and its figures."""

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
from fpplab.pipeline.characterising import characterise_sessions
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
from sim.matching.match import LIMITS, EpochObserver, MatchedTwin, MatchingLimits, match_twin
from sim.matching.parts import check_scans, fit_scans, match_surfaces
from sim.matching.record import MatchingRecord
from sim.matching.reference import Reference
from sim.matching.refusal import Refusals
from sim.matching.result import AblationRow, MatchingFigures
from sim.matching.scene.appearance import match_appearance
from sim.matching.scene.artefacts import BenchScan, compare_artefacts
from sim.matching.scene.surface import with_surfaces
from sim.parameters import TABLE, TwinParameters
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


@dataclass(frozen=True, eq=False)
class MatchingResult(MatchingFigures):
    """What a matching found, and whether to believe it."""

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """Whether to believe the twin; looks at the frames of the poses."""
        return diagnose_matching(self)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was accepted although the twin would have been refused for it; stays with the twin."""
        return (*self.noted, *accepted_findings(self))

    def summary(self) -> dict[str, Any]:
        loss, parameters = self.final.loss.summary(), self.matched.parameters
        light = {name: getattr(parameters, name) for name in TABLE}
        return {
            **self.diagnosis.summary(),
            **loss,
            "epochs": len(self.matched.epochs) - 1,
            "ended": self.matched.ended,
            "gamma": self.gamma.summary() if self.gamma else None,
            "rows": [{"refined": r.refined, "with_gamma": r.gamma, **r.loss} for r in self.rows],
            "explained": self.matched.explained,
            "unexplained_levels": self.matched.unexplained,
            "parameters": {**light, "response": parameters.response.model_dump()},
            "sigma": dict(parameters.sigma),
            "notes": list(self.notes),
            "appearance": self.appearance.summary() if self.appearance else None,
            "baseline_mm": parameters.calibration.baseline_mm,
            "poses": self.by_pose(),
            "artefacts": [part.summary() for part in self.artefacts],
            "surfaces": [part.summary() for part in self.surfaces],
        }


@dataclass(frozen=True)
class MatchingListener:
    """What a matching calls while it works."""

    progress: Progress = no_progress  # with the share that is done
    observe: EpochObserver = ignore  # with every epoch
    tell: Say = ignore  # with what is being done
    prepared: Callable[[Reference], object] = ignore  # with the reference, before the first epoch

    def between(self, first: float, last: float) -> Progress:
        """Give the progress of a part of the work that takes it from one share to another."""
        return lambda share: self.progress(first + (last - first) * share)


SILENT = MatchingListener()


@dataclass(frozen=True, eq=False)
class _Prepared:
    """The bench's recordings as they are matched, and the twin from which the matching starts."""

    reference: Reference
    scans: list[BenchScan]  # of artefacts
    parts: list[BenchScan]  # whose surfaces are matched
    nominal: Twin  # in the reference's geometry, with light and response of its own file
    start: Twin  # with the response matched
    gamma: GammaMatch | None  # where a response was given


def twin_of(rig: Rig, board: str) -> Twin:
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
    listener: MatchingListener = SILENT,
) -> MatchingResult:
    """Match a twin to recorded sessions of a board, and save it unless it must not be used."""
    # Continues where a record in `folder` ends.
    refusals = Refusals(request.accepted)
    _check_inputs(twin, sessions, target, request)
    begun = _characterise_and_place(twin, sessions, target, request, refusals, listener)
    reference = begun.reference
    matched = match_twin(
        reference,
        begun.start,
        begun.start.parameters,
        MatchingRecord(folder),
        request.weights,
        request.limits,
        [*begun.scans, *begun.parts],
        progress=listener.between(0.1, 0.8),
        observe=listener.observe,
        tell=listener.tell,
    )
    best = begun.start.with_parameters(matched.parameters)
    late = _late_findings(reference, best, matched)
    if request.response is not None:
        levelled = with_level_of_card(best, request.response, request.card, reference.settings)
        matched = replace(matched, parameters=levelled)
    result, complete = _compare_bench_and_twin(begun, matched, request, listener)
    result = replace(result, late=late, noted=tuple(refusals.notes))
    if not result.diagnosis.is_useless:
        listener.tell("comparing noise and scans for the intervals of predictions")
        discrepancy_of(reference, complete, [*begun.scans, *begun.parts]).save(folder)
        complete.save(folder, reference.settings, result.notes)
    return result


def _characterise_and_place(
    twin: Twin,
    sessions: Sequence[Session],
    target: Target,
    request: MatchingRequest,
    refusals: Refusals,
    listener: MatchingListener,
) -> _Prepared:
    """Characterise the bench, find parts in their scans, and match the response."""
    listener.tell("characterising the bench")
    characterisation = characterise_sessions(sessions, target, listener.between(0.0, 0.1))
    plausibility.check_geometry(characterisation.calibration, twin.parameters.calibration, refusals)
    if request.response is not None:
        plausibility.check_second_harmonic(request.response, sessions, refusals)
    listener.tell("comparing the scans with the artefacts' shapes")
    scans = fit_scans(twin, request.scans, characterisation.calibration, refusals)
    parts = fit_scans(twin, request.surfaces, characterisation.calibration, refusals)
    reference = Reference.of(sessions, target, characterisation, request.response)
    listener.prepared(reference)
    twin = reference.filtered(twin)
    placed = _place_grey_card(
        with_reference_geometry(twin.parameters, characterisation), request, characterisation, twin
    )
    nominal = twin.with_parameters(request.start(placed))
    if request.response is None:
        return _Prepared(reference, scans, parts, nominal, nominal, None)
    gamma = match_gamma(nominal, request.response, request.card, reference.settings)
    return _Prepared(reference, scans, parts, nominal, nominal.with_parameters(gamma.parameters), gamma)


def _late_findings(reference: Reference, twin: Twin, matched: MatchedTwin) -> tuple[Finding, ...]:
    """Find what only the matched twin shows."""
    late = plausibility.similarity_finding(matched.ssim_board, matched.unexplained)
    blurred = plausibility.sharpness_finding(reference, twin) if matched.refined_focus else None
    return tuple(finding for finding in (late, blurred) if finding is not None)


def _compare_bench_and_twin(
    begun: _Prepared, matched: MatchedTwin, request: MatchingRequest, listener: MatchingListener
) -> tuple[MatchingResult, Twin]:
    """Compare bench and twin before and after the matching; also give the twin with all that was matched."""
    reference, twin = begun.reference, begun.start.with_parameters(matched.parameters)
    listener.tell("comparing before and after")
    before = evaluate(
        reference,
        begun.nominal,
        request.weights,
        characterised=reference.spread_poses(LIMITS.compared_poses),
        progress=listener.between(0.8, 0.84),
    )
    surfaces = match_surfaces(twin, begun.parts, listener.tell)
    twin = twin.with_parameters(with_surfaces(twin.parameters, surfaces))
    listener.tell("matching the board's sheet and the surroundings")
    appearance = match_appearance(reference, twin)
    twin = twin.with_appearance(appearance.appearance)
    listener.tell("judging the result")
    # Only now: grain of the print moves what is found of the board, on the twin as on the bench.
    final = evaluate(
        reference,
        twin,
        request.weights,
        characterised=reference.spread_poses(LIMITS.characterised_poses),
        progress=listener.between(0.84, 0.88),
    )
    own = final.characterisation
    assert own is not None  # since no reprojection error of the twin was given
    artefacts = compare_artefacts(twin, begun.scans, own.calibration, listener.between(0.88, 1.0))
    result = MatchingResult(
        reference=reference,
        nominal=begun.nominal.parameters,
        start=begun.start.parameters,
        gamma=begun.gamma,
        before=before,
        matched=matched,
        final=final,
        rows=_fill_table(begun, twin, request.weights, before, matched, final),
        artefacts=tuple(artefacts),
        accepted=request.accepted,
        card_measured=request.card_scan is not None,
        surfaces=tuple(surfaces),
        appearance=appearance,
    )
    return result, twin


def _check_inputs(twin: Twin, sessions: Sequence[Session], target: Target, request: MatchingRequest) -> None:
    """Refuse before any work: other devices, another board, items that are not there."""
    known = twin.parameters.calibration
    for session in [*sessions, request.card_scan] if request.card_scan else sessions:
        plausibility.check_devices(known.camera.size, known.projector, session)
    plausibility.check_board(twin, target, "--target")
    for scans in (request.scans, request.surfaces):
        check_scans(twin, scans)
    if request.response is not None:
        twin.pose_of(request.card)


def _place_grey_card(
    nominal: TwinParameters, request: MatchingRequest, characterisation: Characterisation, twin: Twin
) -> TwinParameters:
    """Put the grey card where the bench's scan of it shows it."""
    if request.card_scan is None:
        return nominal
    pose = card_pose(request.card_scan, characterisation.calibration, twin.pose_of(request.card))
    return replace(nominal, placed={**nominal.placed, request.card: pose})


def with_reference_geometry(nominal: TwinParameters, characterisation: Characterisation) -> TwinParameters:
    """Put the twin into the geometry that the bench's own characterisation found."""
    measured = characterisation.calibration
    calibration = Calibration(
        measured.camera, measured.projector, measured.T_projector_camera, {}, measured.uncertainty
    )
    return replace(nominal, calibration=calibration, poses=characterisation.poses)


def _fill_table(
    begun: _Prepared,
    twin: Twin,
    weights: Weights,
    before: TwinEvaluation,
    matched: MatchedTwin,
    final: TwinEvaluation,
) -> tuple[AblationRow, ...]:
    """Fill the paper's table: before and after, without and with the response."""
    first, after = AblationRow(False, False, before.loss.summary()), final.loss.summary()
    if begun.gamma is None:
        return first, AblationRow(True, False, after)
    own = begun.nominal.parameters
    without = twin.with_parameters(replace(matched.parameters, response=own.response, white=own.white))
    compared = begun.reference.spread_poses(LIMITS.compared_poses)
    return (
        first,
        AblationRow(False, True, matched.epochs[0].loss),
        AblationRow(True, False, evaluate(begun.reference, without, weights, poses=compared).loss.summary()),
        AblationRow(True, True, after),
    )
