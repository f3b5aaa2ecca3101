"""Coordinates run otherwise along the image than the calibration says."""

from fpplab.diagnosis.evidence import Needs
from fpplab.diagnosis.finding import DetectionStage, FaultCause, Picture
from fpplab.diagnosis.pictures import draw_phases_by_set
from fpplab.diagnosis.plan.limits import PlanCheckLimits

WRONG_ORIENTATION = FaultCause(
    key="wrong_orientation",
    meaning="Images are rotated or mirrored, or the phase steps run in the other direction.",
    remedy="use images with the orientation of the characterisation, or characterise the devices as "
    "they are now",
    measured="direction of the fringe coordinates in the image relative to the calibration; distance "
    "of points from their epipolar lines with the images rotated or mirrored, the steps "
    "reversed or the axes exchanged",
    limit=f"the other direction; {PlanCheckLimits().max_epipolar_px:g} projector px with it undone",
    seen_in="frames",
    picture=Picture(Needs.FRAMES, draw_phases_by_set),
    side_effects=frozenset({"stale_calibration"}),
    invalidates=frozenset({DetectionStage.REFLECTIONS}),
    useless_from=1.0,
)
