"""Causes that a characterisation reports of the poses of its board."""

from functools import partial

from fpplab.diagnosis.finding import FaultCause

SHOWN_BY = "the residuals of every pose in the report"
_cause = partial(FaultCause, shown_by=SHOWN_BY)

LENS_NOT_LOCKED = _cause(
    key="lens_not_locked",
    meaning="The image's scale differs between the poses of a characterisation.",
    remedy="lock focus and aperture of both lenses, let them warm up, and take all poses again",
    measured="scatter of the scale of the camera's image between poses, of which the projector's "
    "coordinates give the place; without the worst pose. In a matching the steepness of a pose's edges "
    "compared with that of the others",
    limit="0.01 %, and what noise explains once in 10,000 times; 12 %",
    seen_in="characterise, match",
)
BOARD_NOT_FOUND = _cause(
    key="board_not_found",
    meaning="The board, or enough of its points, is not found in the frames of a pose.",
    remedy="hold the whole board where the camera sees it and the projector lights it, its front towards "
    "both, nothing before it; compare it with the target file",
    measured="whether the board is found in the frames of a pose, and enough of its points are lit",
    limit="3 tries in succession at the beginning, then 8",
    seen_in="poses, `--guide`",
)
BOARD_MOVED = _cause(
    key="board_moved",
    meaning="The board was not at rest while a pose was taken.",
    remedy="lean the board against something, or clamp it, and take the hands away until the pose is taken",
    measured="residuals of a pose in the projector, compared with those that the other poses predict, where "
    "the camera's are as predicted",
    limit="twice those predicted, and a chance of 0.001",
    seen_in="poses, `--guide`",
)
POSE_MISFIT = _cause(
    key="pose_misfit",
    meaning="A pose fits far worse than the others.",
    remedy="take the pose again; keep the board flat, and camera, projector and lenses as they are",
    measured="residuals of a pose in the camera, compared with those that the other poses predict; SSIM of a "
    "pose over the board below the median",
    limit="twice those predicted, and a chance of 0.001; 0.1",
    seen_in="poses, `--guide`, match",
)
