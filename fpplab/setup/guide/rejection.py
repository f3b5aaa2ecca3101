"""What is wrong with a pose while the board is still there: by its frames, and by its residuals."""

from fpplab.characterisation.guide import PoseFit
from fpplab.diagnosis import Finding, diagnose_frames
from fpplab.diagnosis.causes.camera_focus import CAMERA_FOCUS
from fpplab.diagnosis.causes.no_overlap import NO_OVERLAP
from fpplab.diagnosis.causes.of_characterisation import BOARD_MOVED, BOARD_NOT_FOUND, POSE_MISFIT
from fpplab.diagnosis.causes.projector_dark import PROJECTOR_DARK
from fpplab.diagnosis.causes.projector_focus import PROJECTOR_FOCUS
from fpplab.diagnosis.causes.saturated import SATURATED
from fpplab.diagnosis.causes.underexposed import UNDEREXPOSED
from fpplab.diagnosis.causes.vibration import VIBRATION
from fpplab.patterns.recording import Recording

TRANSIENT_CAUSES = {
    PROJECTOR_DARK,
    NO_OVERLAP,
    SATURATED,
    UNDEREXPOSED,
    CAMERA_FOCUS,
    PROJECTOR_FOCUS,
    VIBRATION,
}
"""Causes that are mostly of one pose alone, and gone when it is taken again."""


def frame_findings(recording: Recording) -> tuple[Finding, ...]:
    return tuple(finding for finding in diagnose_frames(recording) if finding.cause in TRANSIENT_CAUSES)


def unseen_board(reason: str, findings: tuple[Finding, ...]) -> tuple[Finding, ...]:
    """Name a board that was not found, behind what its frames give as the cause."""
    # Where there is no board there are no fringes to be seen either, so darkness comes after it.
    dark = {PROJECTOR_DARK, NO_OVERLAP}
    unseen = Finding(BOARD_NOT_FOUND, reason, 1.0)
    causes = tuple(finding for finding in findings if finding.cause not in dark)
    return (*causes, unseen, *(finding for finding in findings if finding.cause in dark))


def inconsistent_pose(reason: str) -> Finding:
    return Finding(POSE_MISFIT, reason, 1.0)


def residual_finding(fit: PoseFit | None) -> Finding | None:
    # Where the camera's are as predicted and the projector's are not, the board has moved between the image
    # in which it is found and the fringes.
    if fit is None or not fit.contradicting_devices:
        return None
    residuals = [
        f"{name}: {errors.rms_px:.3f} px RMS where the other poses predict {errors.predicted_px:.3f} px"
        for name, errors in (("camera", fit.camera), ("projector", fit.projector))
    ]
    excess = max(e.rms_px / e.predicted_px for e in (fit.camera, fit.projector))
    cause = BOARD_MOVED if fit.contradicting_devices == ("projector",) else POSE_MISFIT
    return Finding(cause, "; ".join(residuals), excess)
