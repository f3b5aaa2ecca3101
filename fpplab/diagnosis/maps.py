"""Whether to believe points of maps that another program decoded, without its frames."""

from fpplab.clouds import Cloud
from fpplab.diagnosis.causes.stale_calibration import STALE_CALIBRATION, StaleCalibrationLimits
from fpplab.diagnosis.finding import Finding
from fpplab.diagnosis.limits import USUAL_LIMITS, DiagnosisLimits
from fpplab.diagnosis.points import systematic_epipolar_px
from fpplab.diagnosis.verdict import Diagnosis, Verdict

NO_FRAMES = "the maps were decoded elsewhere, and there are no frames to judge the points by"
ONE_AXIS = "whether the calibration still holds: maps along both axes would show it"


def diagnose_without_frames(cloud: Cloud, limits: DiagnosisLimits = USUAL_LIMITS) -> Diagnosis:
    """Judge points by their epipolar lines alone: they are doubtful at best."""
    off_px, limit_px = systematic_epipolar_px(cloud), limits.of(StaleCalibrationLimits).max_epipolar_px
    if off_px is None:
        return Diagnosis(Verdict.DOUBTFUL, NO_FRAMES, (), (NO_FRAMES, ONE_AXIS))
    if off_px <= limit_px:
        return Diagnosis(Verdict.DOUBTFUL, NO_FRAMES, (), (NO_FRAMES,))
    evidence = (
        f"points lie {off_px:.2f} projector px off their epipolar lines, systematically "
        f"(at most {limit_px:g})"
    )
    remedy = "see that the maps have the calibration's axes and orientation, and that it is of this rig"
    finding = Finding(STALE_CALIBRATION, evidence, off_px / limit_px, remedy)
    useless = finding.excess >= STALE_CALIBRATION.useless_from
    verdict = Verdict.USELESS if useless else Verdict.DOUBTFUL
    return Diagnosis(verdict, finding.sentence, (finding,), (NO_FRAMES,))
