"""Whether what the camera sees may lie outside of the possible positions, judged from a sample of pixels.

Decoding looks for fringe orders among the possible positions alone. Light from elsewhere is decoded wrongly
there, by a period of the coarsest set, unless the other sets contradict. Where they do, the position that
they agree on tells that the depth range is too narrow; where the sets repeat themselves, nothing can tell.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fpplab.core.conventions import TWO_PI, Axis, Floats, axis_length
from fpplab.patterns.recording import Recording
from fpplab.phase.bounds import PossibleCoordinates, interval_of
from fpplab.phase.consistency import chi2_of_sets
from fpplab.phase.demodulation import AxisPhases, axis_phases
from fpplab.phase.error_model import ErrorModel
from fpplab.phase.limits import ORDERS, OUTSIDE
from fpplab.phase.unwrapping import WavelengthSequence


@dataclass(frozen=True)
class OutsideShare:
    """How many of the sampled pixels with fringes may see something outside of the possible positions."""

    share_outside_depth_range: float  # noise explains their phases outside and nowhere inside
    share_on_both_sides: float  # noise explains their phases inside as well as outside

    def warnings(self) -> tuple[str, ...]:
        """Say what these shares mean, where they are worth it."""
        said = []
        outside, both = self.share_outside_depth_range, self.share_on_both_sides
        if outside > OUTSIDE.warning_share:
            said.append(
                f"at {outside:.0%} of the pixels with fringes the fringe sets agree on a position outside of "
                "the depth range and on none inside, so part of what is seen probably lies outside"
            )
        if both > OUTSIDE.warning_share:
            said.append(
                f"at {both:.0%} of the pixels with fringes the fringe sets agree on a position outside of "
                "the depth range as well as inside, so what lies outside is decoded wrongly, unnoticed"
            )
        return tuple(said)


def outside_share(
    recording: Recording,
    sequences: Sequence[WavelengthSequence],
    errors: ErrorModel,
    bounds: Mapping[Axis, PossibleCoordinates] | None,
) -> OutsideShare | None:
    """Examine a sample of pixels, whether measured or not."""
    sequence = next((s for s in sequences if s.axis in (bounds or {}) and len(s.sets) > 1), None)
    if sequence is None:
        return None
    total = recording.frames[0].size
    pixels = np.arange(0, total, max(total // OUTSIDE.sample_pixels, 1))
    few = replace(recording, frames=[frame.reshape(-1)[pixels] for frame in recording.frames])
    measured = axis_phases(few, sequence, errors)
    length = axis_length(recording.projector_size, sequence.axis)
    low, high = (np.asarray(end) for end in interval_of(bounds, sequence.axis, length, pixels))
    noise_turns = np.max(measured.position_sigma * measured.stripes[:, None], axis=0)
    with_fringes = (noise_turns <= OUTSIDE.max_noise_turns) & (low <= high)
    if with_fringes.sum() < OUTSIDE.min_pixels:
        return None
    inside, outside = _least_chi2(measured, low, high, ORDERS.edge_margin_px / length)
    limit = ORDERS.agreeing_sigmas**2 * (len(sequence.sets) - 1)
    fits = outside[with_fringes] <= limit
    fits_inside = inside[with_fringes] <= limit
    return OutsideShare(float(np.mean(fits & ~fits_inside)), float(np.mean(fits & fits_inside)))


def _least_chi2(measured: AxisPhases, low: Floats, high: Floats, margin: float) -> tuple[Floats, Floats]:
    """Smallest χ² of all orders inside of the intervals, and of all certainly outside."""
    stripes, beyond = measured.stripes[-1], margin + OUTSIDE.beyond_sigmas * measured.position_sigma[-1]
    inside, outside = np.full(low.shape, np.inf), np.full(low.shape, np.inf)
    for order in range(int(np.ceil(stripes)) + 1):
        position = (order + measured.phases[-1] / TWO_PI) / stripes
        chi2 = chi2_of_sets(measured, position)
        is_inside = (low - beyond <= position) & (position <= high + beyond)
        inside = np.where(is_inside, np.minimum(inside, chi2), inside)
        outside = np.where(is_inside | (position > 1.0), outside, np.minimum(outside, chi2))
    return inside, outside
