"""Causes that a characterisation reports of the poses of its board."""

from functools import partial

from fpplab.diagnosis.finding import FaultCause

SHOWN_BY = "the residuals of every pose in the report"
_cause = partial(FaultCause, shown_by=SHOWN_BY)

LENS_NOT_LOCKED = _cause(
    key="lens_not_locked",
    meaning="The image scale differs between the poses of a characterisation.",
    remedy="lock focus and aperture of both lenses, let them warm up, and take all poses again",
    measured="scatter of the camera's image scale between poses located by the projector's "
    "coordinates, without the worst pose. In a matching: sharpness of edges in a pose "
    "relative to the others",
    limit="0.01 %, and a chance of 1 in 10,000 by noise; 12 %",
    seen_in="characterise, match",
)
BOARD_NOT_FOUND = _cause(
    key="board_not_found",
    meaning="The board, or enough of its points, was not found in the frames of a pose.",
    remedy="place the whole board in view of camera and projector, facing both and unobstructed; "
    "compare it with the target file",
    measured="whether the board is found and enough of its points are lit",
    limit="3 failures in succession at the start, then 8",
    seen_in="poses, `--guide`",
)
BOARD_MOVED = _cause(
    key="board_moved",
    meaning="The board moved while a pose was recorded.",
    remedy="support or clamp the board, and do not touch it while a pose is recorded",
    measured="projector residuals of a pose relative to the prediction from the other poses, if its "
    "camera residuals are as predicted",
    limit="twice the prediction, and a chance of 0.001",
    seen_in="poses, `--guide`",
)
POSE_MISFIT = _cause(
    key="pose_misfit",
    meaning="A pose fits much worse than the others.",
    remedy="record the pose again; keep the board flat, and camera, projector and lenses unchanged",
    measured="camera residuals of a pose relative to the prediction from the other poses; SSIM over "
    "the board below the median",
    limit="twice the prediction, and a chance of 0.001; 0.1",
    seen_in="poses, `--guide`, match",
)
