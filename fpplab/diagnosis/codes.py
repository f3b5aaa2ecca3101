"""The verdict on coordinates that codes of other kinds than fringes give, which show fewer faults."""

import math
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.config import Positive
from fpplab.diagnosis.causes.stale_calibration import STALE_CALIBRATION, max_epipolar_px
from fpplab.diagnosis.criteria import CriteriaLimits, Criterion
from fpplab.diagnosis.evidence import Evidence
from fpplab.diagnosis.finding import Finding
from fpplab.diagnosis.geometry import GeometryCheck
from fpplab.diagnosis.limits import DiagnosisLimits, LimitsSection
from fpplab.diagnosis.points import systematic_epipolar_px
from fpplab.diagnosis.ranking import rank_findings
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded
from fpplab.phase.code_decoding import level_range

NOT_SHOWN = "codes: only fringes show flicker, motion, the response and light between surfaces"


class CodeMisfitLimits(LimitsSection):
    """How well frames must fit their code."""

    section: ClassVar[str] = "codes"

    max_misfit: Positive = 5.0
    """RMS of what the code leaves of a pixel's levels, in units of the noise, in the median. Measured on two
    real captures: 1.2 and 1.8; frames out of their order leave ten and more."""


def lit_pixels(recording: Recording) -> int:
    """Count the pixels whose levels change as those of a code do."""
    single = len(recording.frames) == 1  # which shows no change
    change = (recording.frames[0] if single else level_range(recording.frames)) * recording.grey
    return int(np.count_nonzero(change >= 2.0 * recording.plan.masks.modulation_min))


def findings_on_geometry(
    decoded: Decoded,
    cloud: Cloud | None,
    calibration: Calibration | None,
    geometry: GeometryCheck | None,
    limits: DiagnosisLimits,
) -> tuple[Finding, ...]:
    """Look for what points alone show: a rig that is not the one that was calibrated."""
    if cloud is None or calibration is None or not len(cloud):
        return ()
    evidence = Evidence(None, decoded, cloud, calibration, geometry=geometry, limits=limits)
    return rank_findings(
        [each for detector in STALE_CALIBRATION.detectors for each in detector.find(evidence, ())]
    )


def criteria_of_codes(
    decoded: Decoded, cloud: Cloud | None, lit: int, limits: DiagnosisLimits
) -> tuple[Criterion, ...]:
    """Measure what a verdict on codes is given by, on points or on maps alone."""
    measured = _measured(decoded, cloud, max(lit, 1), limits)
    return tuple(criterion for criterion in measured if math.isfinite(criterion.value))


def _measured(
    decoded: Decoded, cloud: Cloud | None, lit: int, limits: DiagnosisLimits
) -> Iterator[Criterion]:
    share = (int(decoded.valid.sum()) if cloud is None else len(cloud)) / lit
    became = "are measured" if cloud is None else "became points"
    meaning = f"the share of the pixels that see the codes which {became}"
    yield Criterion("points", meaning, share, limits.of(CriteriaLimits).min_points_share, at_least=True)
    meaning = "what the codes leave of the pixels' levels, in units of noise,"
    yield Criterion("misfit", meaning, decoded.typical_disagreement, limits.of(CodeMisfitLimits).max_misfit)
    if cloud is not None and (off := systematic_epipolar_px(cloud)) is not None:
        meaning = "the distance of points from their epipolar lines"
        yield Criterion("epipolar_residual", meaning, off, max_epipolar_px(limits, decoded), "px")
