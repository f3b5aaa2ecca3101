"""The axis of a plan whose fringe orders come from the geometry: its one set repeats itself many times.

The coordinate along the other axis puts the point on the camera's ray, and its image in the projector tells
which period is meant. If the geometry has changed, the fringes lie elsewhere. Up to a quarter of a period
that is measured, as the distance from the epipolar lines. Beyond, the next period is soon as near, so that no
order is given.
"""

from dataclasses import replace

import numpy as np

from fpplab.core.conventions import Map, Mask, axis_length
from fpplab.patterns.recording import Recording
from fpplab.phase.bounds import PossibleCoordinates
from fpplab.phase.decoded import Decoded, GuidedAxis
from fpplab.phase.limits import GUIDED_AXIS


def around_prediction(predicted: Map, recording: Recording) -> PossibleCoordinates:
    """Give the period about the predicted coordinate of each pixel, as far as it is on the projector."""
    # predicted (height, width) px
    half = GUIDED_AXIS.half_interval_turns * _period_px(recording)
    last = axis_length(recording.projector_size, recording.plan.axes[0]) - 0.5
    middle = np.nan_to_num(predicted, nan=0.5 * last)
    lower, upper = (np.clip(end, -0.5, last).astype(np.float32) for end in (middle - half, middle + half))
    return PossibleCoordinates(lower, upper)


def joined(leading: Decoded, guided: Decoded, predicted: Map, recording: Recording) -> Decoded:
    """Join the coordinates along both axes where they agree; `recording` is that of the guided axis."""
    axis = recording.plan.axes[0]
    off = np.abs(guided.coordinate(axis) - predicted) > GUIDED_AXIS.max_off_turns * _period_px(recording)
    both = leading.valid & guided.valid
    agreement = GuidedAxis(
        share_off=float(np.mean(off[both])) if both.any() else 0.0,
        phase_error_px=_median(guided.sigma_phase_error, both),
    )
    if agreement.is_contradicted:
        return replace(leading, guided=agreement)
    for values in (*leading.maps, *guided.maps):
        if values is not None and values.flags.writeable:
            values[off | ~both] = np.nan
    along_x, along_y = (leading, guided) if axis == "y" else (guided, leading)
    return replace(
        along_x,
        v=along_y.v,
        v_per_u=_median(along_y.sigma_total / along_x.sigma_total, both & ~off) or 1.0,
        guided=agreement,
        disagreement=leading.disagreement,
        uncertain_order=leading.uncertain_order,
        outside=leading.outside,
        edges=leading.edges,
    )


def _median(values: Map | None, used: Mask) -> float:
    """Give the median of the pixels used, 0 without any."""
    return float(np.median(values[used])) if values is not None and used.any() else 0.0


def _period_px(recording: Recording) -> float:
    (fringe,) = recording.plan.fringes
    return axis_length(recording.projector_size, fringe.axis) / fringe.stripes
