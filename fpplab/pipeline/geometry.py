"""Whether the rig is known to have been as it was characterised when a scan was taken."""

from datetime import timedelta

import numpy as np

from fpplab.calibration.model import Calibration, CalibrationOrigin
from fpplab.clouds import Cloud
from fpplab.devices.rig import GeometrySection
from fpplab.diagnosis.causes.stale_calibration import max_epipolar_px
from fpplab.diagnosis.geometry import GeometryCheck, GeometryDoubt, MarksVerdict
from fpplab.diagnosis.limits import USUAL_LIMITS, DiagnosisLimits
from fpplab.phase import Decoded
from fpplab.reconstruction.hidden_changes import hidden_changes, sampled
from fpplab.reconstruction.triangulation import coordinate_noise
from fpplab.sessions.origin import check_region, foreign_calibration, taken_at
from fpplab.sessions.session import Session

CONFIRM = (
    "show the board to 'fpplab check --rig RIG --calibration CALIBRATION --board POSE', or judge a recorded "
    "pose with 'fpplab characterise --judge CALIBRATION POSE --confirm'"
)
SHOWN_CHANGES = 5  # kinds of changes that are listed, those that cost most (chosen)


def geometry_check(
    session: Session,
    decoded: Decoded,
    cloud: Cloud,
    calibration: Calibration,
    marks: MarksVerdict | None,
    limits: DiagnosisLimits = USUAL_LIMITS,
) -> GeometryCheck:
    doubt = why_unverified(session, calibration)
    if marks is not None and calibration.doubt is None and (doubt is not None or marks.is_unexplained):
        doubt = marks.doubt  # which a statement of the rig's owner settles, unless they look different
    hidden: tuple[tuple[str, float], ...] = ()
    if doubt is not None and not (marks and (marks.verified or marks.change)):
        noticed_px = max_epipolar_px(limits, decoded)
        changes = hidden_changes(cloud, calibration, coordinate_noise(decoded), noticed_px)
        sigma_mm = cloud.sigma_calibration_mm
        certain_um = 0.0 if sigma_mm is None else 1e3 * float(np.median(sampled(sigma_mm)))
        costs = [(change.meaning, change.displacement_um) for change in changes[:SHOWN_CHANGES]]
        hidden = tuple((what, um) for what, um in costs if um > certain_um)
    by_marks = marks is not None and marks.verified
    return GeometryCheck(
        doubt,
        hidden,
        foreign_calibration(calibration, session),
        by_marks or check_region(calibration, session),
        marks.change if marks else None,
        by_marks,
    )


def why_unverified(session: Session, calibration: Calibration) -> GeometryDoubt | None:
    if calibration.doubt is not None:
        detail = f"the calibration: {calibration.doubt}"
        return GeometryDoubt("the calibration was doubtful when it was made", "characterise again", detail)
    times, origin = taken_at(session), calibration.origin
    verified = origin.verified if origin else None
    if times is None:
        return GeometryDoubt(
            "nothing records when and with which devices the images were taken",
            "measure a part of known shape on the same rig, and compare it",
        )
    if verified is None:
        return GeometryDoubt("nothing records when the poses of the calibration were taken", CONFIRM)
    rig = session.rig() or {}
    stated = rig.get("geometry")
    if stated is None:
        return GeometryDoubt(
            "the rig file does not state for how long the rig keeps it",
            "add for how many hours it does, such as 'geometry: {max_age_h: 8}'",
        )
    section = GeometrySection.model_validate(stated)
    if (doubt := _settings_doubt(section, origin)) is not None:
        return doubt
    max_age_h = section.max_age_h
    apart_h = max(abs(time - verified) for time in times) / timedelta(hours=1)
    if apart_h <= max_age_h:
        return _stage_doubt(session, calibration)
    reason = f"a board last showed it {apart_h:.1f} h from the scan (at most {max_age_h:g} h)"
    return GeometryDoubt(reason, CONFIRM)


def _settings_doubt(now: GeometrySection, then: CalibrationOrigin | None) -> GeometryDoubt | None:
    if then is None:
        return None
    stated, before = now.settings or {}, then.settings or {}
    for name in sorted({*stated, *before}):
        if stated.get(name) != before.get(name):
            shown, was = (values.get(name, "not stated") for values in (stated, before))
            reason = f"'{name}' is {shown} in the rig file, and was {was} for the poses of the calibration"
            return GeometryDoubt(reason, f"set it as it was and state it, or {CONFIRM}")
    if now.temperature_c is None or then.temperature_c is None:
        return None
    warmer_k = now.temperature_c - then.temperature_c
    if abs(warmer_k) <= now.max_change_k:
        return None
    reason = (
        f"the rig is at {now.temperature_c:g} °C, and was at {then.temperature_c:g} °C for the calibration's "
        f"poses (at most {now.max_change_k:g} K apart)"
    )
    return GeometryDoubt(reason, f"wait, or {CONFIRM}")


def _stage_doubt(session: Session, calibration: Calibration) -> GeometryDoubt | None:
    calibrated_mm = calibration.origin.stage_mm if calibration.origin else None
    has_stage = (session.rig() or {}).get("stage") is not None
    if not has_stage or None not in (calibrated_mm, session.plan.stage_mm):
        return None
    reason = "the plans do not say where the stage stood, for the scan and for the board"
    return GeometryDoubt(reason, "write 'stage_mm' into both plans")
