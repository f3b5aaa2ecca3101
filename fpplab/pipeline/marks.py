"""What the reference marks in a scan say about the rig's geometry, in µm at the points of the scan."""

from dataclasses import dataclass, replace

import numpy as np

from fpplab.calibration.board import LocatedMarks
from fpplab.calibration.displacements import (
    CoordinateNoise,
    calibration_jacobian,
    covariance_root,
    displacements_by_mode,
)
from fpplab.calibration.model import Calibration
from fpplab.characterisation import Correction
from fpplab.characterisation.marks import (
    MarksComparison,
    compare_marks,
    locate_marks,
    observe_marks,
    triangulate_marks,
)
from fpplab.characterisation.observation import Observation
from fpplab.characterisation.working_volume import without_motion
from fpplab.clouds import Cloud
from fpplab.core import config
from fpplab.core.depth import DepthRange
from fpplab.core.errors import CalibrationError
from fpplab.diagnosis.geometry import GeometryDoubt, MarksVerdict, SeenChange, in_words
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.pipeline.geometry import CONFIRM
from fpplab.reconstruction.depth_range import decoding_bounds
from fpplab.reconstruction.hidden_changes import sampled
from fpplab.sessions.session import Session
from fpplab.targets import Target

DEPTH_MARGIN = 0.05  # how far marks may have moved, as a share of their depth (chosen)


CORRECT = "correct the calibration by the marks: 'fpplab characterise --correct CALIBRATION SCAN --out NEW'"


SeenMarks = MarksComparison | GeometryDoubt
"""What a scan shows of the marks: a doubt where too few are in view."""


def compare_marks_in(
    recording: Recording, decoded: Decoded, calibration: Calibration, marks: LocatedMarks
) -> SeenMarks:
    try:
        return compare_marks(calibration, marks, marks_in(recording, decoded, calibration, marks))
    except CalibrationError as error:
        return GeometryDoubt(str(error), f"uncover the marks, or {CONFIRM}")


def widened_by_marks(calibration: Calibration, comparison: SeenMarks) -> Calibration:
    """Add the change of the rig that marks make likely, and what they leave open, to the uncertainty."""
    if calibration.uncertainty is None or not isinstance(comparison, MarksComparison):
        return calibration
    changed = comparison.covariance + np.outer(comparison.change, comparison.change)
    return replace(calibration, uncertainty=calibration.uncertainty.widened(changed))


def marks_verdict(
    compared: SeenMarks, cloud: Cloud, noise: CoordinateNoise, calibration: Calibration
) -> MarksVerdict:
    """Judge the geometry by what a change that the marks allow would displace the points by."""
    if isinstance(compared, GeometryDoubt):
        return MarksVerdict(False, doubt=compared)
    costs = _costs(cloud, calibration, noise, compared)
    if compared.explained and all(cost.total_um <= cost.stated_um for cost in costs):
        return MarksVerdict(True)
    if not compared.explained:
        reason = "the reference marks look different, and no change of place, lens or picture explains how"
        return MarksVerdict(False, doubt=GeometryDoubt(reason, "characterise again"), is_unexplained=True)
    worst = max(costs, key=lambda cost: cost.excess)
    if compared.contradicted:
        parts = [f"{name} ({100 * p:.0f} %)" for name, p in compared.probabilities.items() if p > 0.05]
        sentence = (
            f"the reference marks show a change of the rig: {worst.what} {in_words(worst.change_um)} off "
            f"(stated: {in_words(worst.stated_um)}); probably {', '.join(parts)}"
        )
        return MarksVerdict(False, SeenChange(sentence, worst.excess, CORRECT))
    reason = f"the reference marks leave open whether {worst.what} {in_words(worst.total_um)} off"
    return MarksVerdict(False, doubt=GeometryDoubt(reason, f"show more of the marks, or {CONFIRM}"))


def marks_in(
    recording: Recording, decoded: Decoded, calibration: Calibration, marks: LocatedMarks
) -> Observation:
    target = config.validate(marks.target, Target, "the calibration's marks")
    if recording.depth is not None:  # which the marks may lie out of
        depth_mm = triangulate_marks(calibration, marks)[:, 2]
        interval = (1 - DEPTH_MARGIN) * float(depth_mm.min()), (1 + DEPTH_MARGIN) * float(depth_mm.max())
        depth = DepthRange(interval, "the reference marks")
        decoded = _decode(replace(recording, depth=depth), calibration)
    observed = observe_marks(recording.name, recording.mean_image(), decoded, target)
    if observed is None:
        raise CalibrationError("none of the reference marks are in view")
    return observed


def _decode(recording: Recording, calibration: Calibration) -> Decoded:
    return decode(recording, bounds=decoding_bounds(recording.plan, calibration, recording.depth))


def locate_session_marks(session: Session, target: Target, calibration: Calibration) -> Calibration:
    """Add reference marks to a calibration, as a session that was taken with it shows them."""
    recording = session.recording()
    calibration.check_camera(session.format[:2], session.path)
    calibration.check_projector(*session.projector(), session.path)
    name, image = session.path.name, recording.mean_image()
    return replace(calibration, marks=locate_marks(name, image, _decode(recording, calibration), target))


def correct_by_marks(session: Session, calibration: Calibration, marks: LocatedMarks) -> Correction:
    recording = session.recording()
    observed = marks_in(recording, _decode(recording, calibration), calibration, marks)
    compared = compare_marks(calibration, marks, observed)
    if not compared.explained:
        raise CalibrationError(
            f"{session.path}: no change of place, lenses or pictures explains how the reference marks look; "
            "characterise again"
        )
    corrected = compared.corrected
    if np.isfinite(observed.projector_px).all():
        now = LocatedMarks(marks.target, observed.ids, observed.camera_px, observed.projector_px)
        corrected = replace(corrected, marks=now)
    return Correction(corrected, compared.probabilities, compared.as_characterised, compared.after)


@dataclass(frozen=True)
class _Cost:
    """What a change does to the points, RMS, beside the uncertainty that is stated for them anyway."""

    what: str
    change_um: float  # by the change that is expected
    open_um: float  # by what is open
    stated_um: float

    @property
    def total_um(self) -> float:
        return float(np.hypot(self.change_um, self.open_um))

    @property
    def excess(self) -> float:
        return self.total_um / max(self.stated_um, 1e-3)


def _costs(
    cloud: Cloud, calibration: Calibration, noise: CoordinateNoise, compared: MarksComparison
) -> list[_Cost]:
    points = sampled(cloud.points)
    modes = np.column_stack([compared.change, covariance_root(compared.covariance)])
    moved = (calibration_jacobian(points, calibration, noise) @ modes).reshape(-1, modes.shape[1])
    stated = displacements_by_mode(points, calibration, noise).reshape(len(moved), -1)
    costs = []
    for what, displaced, before in (
        ("points are", moved, stated),
        ("the form is", without_motion(moved, points), without_motion(stated, points)),
    ):
        change, *spread = 1e3 * np.sqrt(np.square(displaced).sum(axis=0) / len(points))
        stated_um = 1e3 * np.sqrt(np.square(before).sum() / len(points))
        costs.append(_Cost(what, float(change), float(np.linalg.norm(spread)), float(stated_um)))
    return costs
