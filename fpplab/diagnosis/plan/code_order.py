"""Whether the images of codes come in the order that the plan states: other orders are tried.

At the edge of a cell one bit alone is half lit. With images in another order, words of neighbouring cells
differ in several bits, and the half-lit levels fit no code: the likelihood of the frames falls.
"""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from fpplab.core.config import Positive
from fpplab.diagnosis.limits import USUAL_LIMITS, DiagnosisLimits, LimitsSection
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase.code_decoding import sampled_likelihood
from fpplab.phase.coded_axes import axes_by_codes, axes_with_orders, sets_of_axis

_Order = NDArray[np.int64]  # which frame of an axis is taken for each image


class CodeOrderLimits(LimitsSection):
    """How much likelier another order must be."""

    min_log_ratio: Positive = 50.0
    """Logarithm of the ratio of likelihoods of all sampled pixels. Chosen: chance gives a few, and an
    exchange of the two finest bits, which shows least, hundreds."""


def code_order_fault(recording: Recording, limits: DiagnosisLimits = USUAL_LIMITS) -> str | None:
    """Name the order of images that fits much better than the plan's; None where none does."""
    plan, size = recording.plan, recording.projector_size
    if recording.fringe_part is recording:
        return None
    with_orders = axes_with_orders(plan, size)
    for axis in (*axes_by_codes(plan, size), *with_orders):
        sets = sets_of_axis(plan, axis, with_fringes=axis not in with_orders)
        rivals = list(_rivals(plan, sets))
        likelihoods = sampled_likelihood(recording, axis, sets, [order for _, order in rivals])
        if likelihoods is None:
            continue
        best = int(np.argmax(likelihoods))
        if likelihoods[best] - likelihoods[0] > limits.of(CodeOrderLimits).min_log_ratio:
            return f"the plan does not fit its images: along {axis}, {rivals[best][0]}"
    return None


def _rivals(plan: Plan, sets: tuple[int, ...]) -> Iterator[tuple[str, _Order]]:
    """Orders of an axis' frames with what they mean, the plan's first."""
    images = [(k, step) for k in sets for step in range(plan.sets[k].images)]
    stated = np.arange(len(images))
    yield "", stated
    at = {image: n for n, image in enumerate(images)}
    for k in sets:
        own = np.array([at[k, step] for step in range(plan.sets[k].images)])
        for meaning, turned in plan.sets[k].other_orders():
            order = stated.copy()
            order[own] = own[turned]
            yield meaning, order
    of_codes = [image for image in images if not isinstance(plan.sets[image[0]], FringeSet)]
    for pair in combinations(of_codes, 2):
        order = stated.copy()
        order[[at[image] for image in pair]] = [at[image] for image in reversed(pair)]
        first, second = (plan.set_starts[k] + step for k, step in pair)
        yield f"images {first} and {second} (from 0) are exchanged; rename or list them", order
