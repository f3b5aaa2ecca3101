"""Why coordinates run otherwise than a calibration says: rival explanations, each tried on the frames.

The sets agree under all of them, so that only the geometry decides. Along one axis it often does not, and
then nothing is advised that would put points at wrong places without a sign of it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import AXES, Axis
from fpplab.core.errors import ConfigError
from fpplab.diagnosis.limits import USUAL_LIMITS, DiagnosisLimits
from fpplab.diagnosis.plan.edits import Edit, Sets, other_steps
from fpplab.diagnosis.plan.limits import PlanCheckLimits
from fpplab.diagnosis.plan.placement import PlacedSample, Placement, Turn
from fpplab.diagnosis.plan.sample import PhaseSample
from fpplab.patterns.fringe_sets import SteppedFringes, indices_along
from fpplab.patterns.recording import Recording
from fpplab.phase import decode

AS_RECORDED: Turn = (1, 0), (0, 1)


def _unchanged(sets: Sets) -> Sets:
    return sets


def _reversed_along(*axes: Axis) -> Callable[[Sets], Sets]:
    return lambda sets: tuple(
        s.model_copy(update={"shift_sign": -s.shift_sign}) if s.axis in axes else s for s in sets
    )


def _exchanged(sets: Sets) -> Sets:
    return tuple(s.model_copy(update={"axis": "y" if s.axis == "x" else "x"}) for s in sets)


@dataclass(frozen=True)
class OrientationRival:
    """One explanation: what happened, how to undo it, and how to try that."""

    meaning: str  # as a clause
    remedy: str
    turn: Turn = AS_RECORDED
    edit: Callable[[Sets], Sets] = field(default=_unchanged)
    axes: tuple[Axis, ...] = ()  # that a plan must code for it


def _sign_rival(*axes: Axis) -> OrientationRival:
    sets = " and ".join(f"every set along {axis}" for axis in axes)
    return OrientationRival(
        f"the steps of {sets} run the other way, or the projector shows its picture mirrored",
        f"change the sign of 'shift_sign' in {sets}",
        edit=_reversed_along(*axes),
        axes=axes,
    )


def _image_rival(meaning: str, undo: str, *turn: tuple[int, int]) -> OrientationRival:
    remedy = f"{undo} before they are imported, or switch that off in the camera"
    return OrientationRival(meaning, remedy, (turn[0], turn[1]))


ORIENTATION_RIVALS = (
    _image_rival("the images are turned by 180°", "turn the images by 180°", (-1, 0), (0, -1)),
    _image_rival(
        "the images are mirrored, left to right", "mirror the images left to right", (-1, 0), (0, 1)
    ),
    _image_rival(
        "the images are upside down, mirrored top to bottom",
        "mirror the images top to bottom",
        (1, 0),
        (0, -1),
    ),
    _sign_rival("x"),
    _sign_rival("y"),
    _sign_rival("x", "y"),
    _image_rival(
        "the images are turned by 90° to the right", "turn the images by 90° to the left", (0, 1), (-1, 0)
    ),
    _image_rival(
        "the images are turned by 90° to the left", "turn the images by 90° to the right", (0, -1), (1, 0)
    ),
    _image_rival("rows and columns of the images are exchanged", "exchange rows and columns", (0, 1), (1, 0)),
    _image_rival(
        "rows and columns of the images are exchanged, and both run backwards",
        "turn the images by 180° and exchange rows and columns",
        (0, -1),
        (-1, 0),
    ),
    OrientationRival(
        "the axes of the sets are exchanged",
        "write the other axis in every set",
        edit=_exchanged,
        axes=("x", "y"),
    ),
)
"""Explanations that are tried. The more frequent stand first; the order decides between equals."""


@dataclass(frozen=True)
class OrientationCheck:
    """Which explanations agree with the calibration, the best first."""

    as_recorded: Placement
    fitting: tuple[tuple[OrientationRival, Placement], ...]

    @property
    def evidence(self) -> str:
        """What was tried, in words; empty where nothing fits."""
        if not self.fitting:
            return ""
        meanings = ", or ".join(rival.meaning for rival, _ in self.fitting)
        if len(self.fitting) > 1:
            return f"{meanings}; all of these fit equally, and only one can be right"
        distance = self.fitting[0][1].epipolar_px
        if distance is None:
            return f"{meanings}, which alone puts points where they can lie"
        return (
            f"{meanings}: with that undone points lie {distance:.2f} projector px off their epipolar lines, "
            f"and {self.as_recorded.epipolar_px or 0.0:.3g} px without"
        )

    @property
    def remedy(self) -> str | None:
        """What to do; None where nothing fits."""
        if not self.fitting:
            return None
        if len(self.fitting) == 1:
            return self.fitting[0][0].remedy
        return (
            "compare an image with one of the characterisation: where it stands otherwise, turn all images "
            "back before they are imported; record fringes along both axes, which show what is wrong"
        )


def check_orientation(
    recording: Recording, calibration: Calibration, limits: DiagnosisLimits = USUAL_LIMITS
) -> OrientationCheck | None:
    """Try every explanation of coordinates that run against a calibration."""
    check_limits = limits.of(PlanCheckLimits)
    prepared = _prepared(recording, check_limits)
    if prepared is None:
        return None
    sets, sampled, sample = prepared
    placed = {sets: _placed(sampled, sets, sample)}
    as_recorded = placed[sets].placement(calibration, AS_RECORDED, recording.depth)
    fitting = []
    width, height = calibration.camera.size
    for rival in ORIENTATION_RIVALS:
        is_quarter = rival.turn[0][0] == 0
        if any(axis not in recording.plan.axes for axis in rival.axes) or (is_quarter and width != height):
            continue
        edited = rival.edit(sets)
        if edited not in placed:
            try:
                placed[edited] = _placed(sampled, edited, sample)
            except ConfigError:
                continue
        placement = placed[edited].placement(calibration, rival.turn, recording.depth)
        if placement.fits(check_limits):
            fitting.append((rival, placement))
    if len(recording.plan.axes) == 2 and fitting:
        best = min(placement.epipolar_px or 0.0 for _, placement in fitting)
        limit = max(check_limits.max_equal_ratio * best, check_limits.max_equal_epipolar_px)
        fitting = [(rival, p) for rival, p in fitting if (p.epipolar_px or 0.0) <= limit]
        fitting.sort(key=lambda tried: tried[1].epipolar_px or 0.0)
    return OrientationCheck(as_recorded, tuple(fitting))


def steps_on_epipolar_lines(
    recording: Recording, calibration: Calibration, limits: DiagnosisLimits = USUAL_LIMITS
) -> Edit | None:
    """Find the steps with which points along both axes lie on their epipolar lines."""
    # Where a response is bent, the sets may agree under wrong steps within what their phases may be off.
    prepared = _prepared(recording, limits.of(PlanCheckLimits))
    if prepared is None or len(recording.plan.axes) < 2:
        return None
    sets, sampled, sample = prepared
    for edit in other_steps(sets):
        placement = _placed(sampled, edit.sets, sample).placement(calibration, AS_RECORDED, recording.depth)
        if placement.fits(limits.of(PlanCheckLimits)):
            return edit
    return None


def _prepared(recording: Recording, limits: PlanCheckLimits) -> tuple[Sets, Recording, PhaseSample] | None:
    """Sets and some pixels of a plan of sinusoids; None of others, and where few pixels are lit."""
    sets = tuple(s for s in recording.plan.sets if isinstance(s, SteppedFringes))
    if len(sets) < len(recording.plan.sets):
        return None
    sample = PhaseSample.of(recording.frames, [s.images for s in sets], recording.full_scale, limits)
    if sample is None:
        return None
    return sets, recording.part(sample.rows), sample


def _placed(sampled: Recording, sets: Sets, sample: PhaseSample) -> PlacedSample:
    plan = sampled.plan.model_copy(update={"fringes": sets})
    gradients = {
        axis: sets[ranked[-1]].shift_sign * sample.gradients[ranked[-1]]
        for axis in AXES
        if (ranked := indices_along(sets, axis))
    }
    decoded = decode(replace(sampled, plan=plan))
    coordinates = {axis: decoded.coordinate(axis)[sample.lit].astype(np.float64) for axis in gradients}
    pixels = np.argwhere(sample.lit)[:, ::-1] * float(sample.rows[0].step)
    return PlacedSample(pixels, coordinates, gradients)
