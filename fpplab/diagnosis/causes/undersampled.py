"""The finest stripes are too narrow for the camera's pixels."""

from collections.abc import Iterator, Sequence

import numpy as np

from fpplab.core.config import Positive
from fpplab.core.conventions import axis_length
from fpplab.core.drawing import ACCENT
from fpplab.diagnosis.evidence import Evidence, Needs
from fpplab.diagnosis.finding import DetectionStage, Detector, FaultCause, Figure, Finding, Picture
from fpplab.diagnosis.limits import LimitsSection
from fpplab.diagnosis.pictures import curve_axes


class UndersampledLimits(LimitsSection):
    """How wide stripes should be."""

    min_px_per_stripe: Positive = 4.0
    """Camera px that a stripe covers. Derived: pixels of a quarter period keep 0.9 of the contrast."""


def _find(evidence: Evidence, _: Sequence[Finding]) -> Iterator[Finding]:
    sample, plan = evidence.points, evidence.plan
    limit = evidence.limits.of(UndersampledLimits).min_px_per_stripe
    for axis in plan.axes:
        stripes = plan.fringes[plan.finest_set(axis)].stripes
        covered = axis_length(sample.calibration.projector.size, axis) / stripes
        covered /= float(sample.projector_px_per_px["xy".index(axis)])
        if covered < limit:
            text = f"the finest stripes along {axis} cover {covered:.1f} camera px (at least {limit:g})"
            yield Finding(UNDERSAMPLED, text, limit / covered)


def _draw(evidence: Evidence, _: Finding) -> Figure:
    sample = evidence.frames
    plan = sample.recording.plan
    k = plan.finest_set()
    frame = sample.recording.frames[plan.set_starts[k]]
    rows, columns = np.nonzero(sample.lit)
    row, column = (int(np.median(indices)) * sample.step for indices in (rows, columns))
    along_u = plan.fringes[k].axis == "x"
    line, middle = (frame[row], column) if along_u else (frame[:, column], row)
    shown = np.arange(max(middle - 30, 0), min(middle + 30, len(line)))
    figure, axes = curve_axes()
    axes.plot(shown, line[shown], "o-", color=ACCENT, markersize=3, linewidth=0.8)
    axes.set(xlabel=f"camera {'u' if along_u else 'v'} in px", ylabel="grey level")
    limit = evidence.limits.of(UndersampledLimits).min_px_per_stripe
    axes.set_title(f"finest fringes; a stripe should cover {limit:g} px or more")
    return figure


UNDERSAMPLED = FaultCause(
    key="undersampled",
    meaning="The finest stripes are too narrow for the camera's pixels.",
    remedy="use a plan with fewer stripes or less binning, or move the camera closer",
    measured="camera pixels per stripe",
    limit=f"{UndersampledLimits().min_px_per_stripe:g}",
    seen_in="points",
    detectors=(Detector(DetectionStage.POINTS, _find),),
    picture=Picture(Needs.FRAMES, _draw),
)
