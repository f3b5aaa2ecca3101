"""What fine fringe sets disagree by beyond noise: a common error, by which the uncertainty is widened.

Light by way of other faces bends each set by another amount. The local root mean square of the
disagreement, in units of noise, is then the ratio of the error to the stated one (Birge's ratio); that of a
single pixel is mostly chance.
"""

from dataclasses import replace

import cv2
import numpy as np

from fpplab.core.conventions import Axis, Map
from fpplab.patterns.plan import Plan
from fpplab.phase.decoded import Decoded
from fpplab.phase.limits import DISAGREEMENT as LIMITS


def widened_by_disagreement(decoded: Decoded, plan: Plan) -> Decoded:
    """Widen the uncertainty of common errors where the sets of a plan of fine fringes disagree."""
    own, misfit = decoded.sigma_phase_error, decoded.disagreement
    if own is None or misfit is None or not all(_are_fine(plan, axis) for axis in plan.unwrapped_axes):
        return decoded
    ratio = _local_rms(misfit) / np.float32(max(1.0, decoded.typical_disagreement))
    excess = np.where(ratio > LIMITS.min_ratio, ratio**2 - 1.0, np.float32(0.0))
    total = own**2 + decoded.sigma**2
    return replace(decoded, sigma_phase_error=np.sqrt(own**2 + excess * total).astype(np.float32))


def _are_fine(plan: Plan, axis: Axis) -> bool:
    stripes = [plan.fringes[k].stripes for k in plan.sets_along(axis)]
    return max(stripes) <= LIMITS.max_stripes_ratio * min(stripes)


def _local_rms(values: Map) -> Map:
    known = np.isfinite(values)
    side = (LIMITS.window_px, LIMITS.window_px)
    squares = cv2.blur(np.where(known, values, np.float32(0.0)) ** 2, side)
    share = cv2.blur(known.astype(np.float32), side)
    return np.asarray(np.sqrt(squares / np.maximum(share, np.float32(1e-6))), np.float32)
