"""Whether to believe a matched twin: by the recordings that it was fitted to, and by what the fit left."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from fpplab.diagnosis import Diagnosis, Finding, diagnose_poses, diagnosis_of
from fpplab.diagnosis.causes.of_characterisation import LENS_NOT_LOCKED, POSE_MISFIT
from fpplab.diagnosis.causes.of_matching_and_search import (
    ARTEFACT_MISFIT,
    AT_BORDER,
    ENDED_EARLY,
    NO_GAIN,
    POINTS_MISFIT,
    UNLIKE_IMAGES,
)
from fpplab.patterns.recording import Recording
from fpplab.sessions.session import Session
from fpplab.workflows.characterise import findings_of_poses
from sim.matching.judging.plausibility import LIMITS as PLAUSIBLE
from sim.matching.match import CONVERGED
from sim.matching.match import LIMITS as STEPS
from sim.matching.result import MatchingFigures
from sim.parameters import ADJUSTABLE


@dataclass(frozen=True)
class TwinVerdictLimits:
    """From which differences on a matched twin is not believed."""

    max_rms_difference: float = 0.03  # over the board without noise, as a share of full scale (chosen)
    max_reprojection_difference_px: float = 0.1  # of bench and twin (chosen)
    max_ssim_drop: float = 0.1  # of one pose below the median of all, over the board (chosen)
    max_artefact_share: float = 0.3  # difference on an artefact, as a share of the bench's (chosen)
    max_artefact_um: float = 2.0  # difference on an artefact in µm; both must be exceeded (chosen)
    border_share: float = 1e-3  # of a parameter's range that counts as its border (chosen)


LIMITS = TwinVerdictLimits()

RUINOUS = {NO_GAIN: 1.0, UNLIKE_IMAGES: PLAUSIBLE.max_image_difference, LENS_NOT_LOCKED: 1.0}
"""Excess from which on the twin must not be used, unless the cause is accepted."""


def diagnose_matching(figures: MatchingFigures) -> Diagnosis:
    recorded = diagnose_poses(_recordings(figures.reference.sessions), (), {}).findings
    ruinous = {cause: excess for cause, excess in RUINOUS.items() if cause not in figures.accepted}
    unknown = [] if figures.artefacts else ["artefact_misfit: no --scan of an artefact was given"]
    if figures.gamma and not figures.card_measured:
        unknown.append("the grey card stands where the twin's file says: no --card ITEM=SESSION was given")
    poses = len(figures.reference.sessions)
    good = (
        f"its images differ from the bench's by {figures.matched.unexplained:.2f} levels RMS in {poses} poses"
    )
    return diagnosis_of([*recorded, *_own_findings(figures)], good, unknown, ruinous)


def accepted_findings(figures: MatchingFigures) -> tuple[str, ...]:
    """List what would have made the twin useless, had it not been accepted."""
    return tuple(
        f"{finding.cause} accepted: {finding.evidence}"
        for finding in _own_findings(figures)
        if finding.cause in figures.accepted and finding.excess >= RUINOUS.get(finding.cause, np.inf)
    )


def _own_findings(figures: MatchingFigures) -> list[Finding]:
    return [
        *findings_of_poses(figures.reference.characterisation),  # a twin inherits what moved between poses
        *figures.late,
        *_of_fit(figures),
        *_of_poses(figures),
        *_at_borders(figures),
        *_of_artefacts(figures),
    ]


def _recordings(sessions: Sequence[Session]) -> Iterator[tuple[str, Recording]]:
    for session in sessions:
        yield session.path.name, session.recording(verify=False)


def _of_fit(figures: MatchingFigures) -> Iterator[Finding]:
    matched = figures.matched
    final, before = figures.final.loss, figures.before.loss
    if final.board - before.board > STEPS.equal_loss:
        evidence = f"the loss over the board is {final.board:.4f}, and was {before.board:.4f} before"
        yield Finding(NO_GAIN, evidence, final.board / before.board)
    if matched.ended != CONVERGED:
        evidence = f"the matching ended {matched.ended}, before its loss had converged"
        advice = "name another --out, and give more --epochs or --seconds"
        yield Finding(ENDED_EARLY, evidence, 1.0, advice)
    noise = min(max(sum(matched.explained.get(name, 0.0) for name in ("vibration", "noise")), 0.0), 1.0)
    unexplained = matched.unexplained * float(np.sqrt(1.0 - noise))
    max_rms = LIMITS.max_rms_difference * figures.reference.full_scale
    if unexplained > max_rms:
        evidence = (
            f"the images differ over the board by {unexplained:.1f} levels RMS without noise (at most "
            f"{max_rms:.1f})"
        )
        yield Finding(UNLIKE_IMAGES, evidence, unexplained / max_rms)
    if abs(final.rms_difference_px) > LIMITS.max_reprojection_difference_px:
        evidence = (
            f"the reprojection errors of bench and twin differ by {abs(final.rms_difference_px):.3f} px "
            f"(at most {LIMITS.max_reprojection_difference_px:g})"
        )
        yield Finding(
            POINTS_MISFIT, evidence, abs(final.rms_difference_px) / LIMITS.max_reprojection_difference_px
        )


def _of_poses(figures: MatchingFigures) -> Iterator[Finding]:
    ssim = {pose["pose"]: float(pose["ssim_board_after"]) for pose in figures.by_pose()}
    usual = float(np.median(list(ssim.values())))
    worst = min(ssim, key=lambda name: ssim[name])
    if usual - ssim[worst] > LIMITS.max_ssim_drop:
        evidence = f"{worst}: SSIM over the board {ssim[worst]:.3f}, of all poses {usual:.3f} in the median"
        yield Finding(POSE_MISFIT, evidence, (usual - ssim[worst]) / LIMITS.max_ssim_drop)


def _at_borders(figures: MatchingFigures) -> Iterator[Finding]:
    now, start = figures.matched.parameters, figures.start
    for name, parameter in ADJUSTABLE.items():
        if getattr(now, name, 0.0) is None:  # a focus that was not searched
            continue
        value, fit = parameter.read(now), parameter.fit
        span = LIMITS.border_share * (fit.upper - fit.lower)
        below = value - fit.lower <= span and not fit.may_be_at_lower_bound
        moved = getattr(start, name, 0.0) is None or value != parameter.read(start)
        if moved and (below or fit.upper - value <= span):
            evidence = f"{name} is {value:.4g}, and may be from {fit.lower:g} to {fit.upper:g}"
            advice = "correct what the twin's file says of lamp, lens or board, and match again"
            yield Finding(AT_BORDER, evidence, 1.0, advice)


def _of_artefacts(figures: MatchingFigures) -> Iterator[Finding]:
    for artefact in figures.artefacts:
        share = abs(artefact.delta_um) / max(artefact.reference_um, 1e-9)
        if share > LIMITS.max_artefact_share and abs(artefact.delta_um) > LIMITS.max_artefact_um:
            evidence = (
                f"{artefact.item}: {artefact.twin_um:.1f} µm in the twin, {artefact.reference_um:.1f} µm "
                "on the bench"
            )
            yield Finding(ARTEFACT_MISFIT, evidence, share / LIMITS.max_artefact_share)
