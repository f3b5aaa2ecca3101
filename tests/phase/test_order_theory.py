"""Wrong orders kept and right ones lost, beside the exact posterior of all orders."""

import numpy as np
import pytest
from scipy.special import erfc

from fpplab.phase import decode, wrapped_phase
from fpplab.phase.error_model import error_model_of
from tests.phase.test_fusion import WIDTH
from tests.phase.test_wrong_order import limited, noisy

LIMIT = 1e-4
RATIOS = (4, 6, 9, 12, 16, 20, 28, 40)
PLANS = [
    ((1.0, 8.0, 64.0), (12, 12, 12), "hierarchical"),
    ((1.0, 8.0, 64.0), (3, 3, 3), "hierarchical"),
    ((1.0, 19.03, 167.2), (3, 3, 12), "hierarchical"),
    ((0.95, 6.1, 30.7, 140.3), (4, 4, 4, 4), "hierarchical"),
    ((1.0, 12.0), (4, 4), "hierarchical"),
    ((59.0, 64.0, 70.0), (3, 3, 3), "heterodyne"),
    ((49.0, 56.0, 64.0), (6, 6, 6), "heterodyne"),
    ((146.0, 156.0, 167.0), (3, 3, 3), "heterodyne"),
    ((12.0, 45.0, 167.0), (3, 3, 3), "guided"),
    ((14.0, 100.0), (6, 6), "guided"),
    ((12.0, 100.0), (4, 4), "guided"),
    ((59.0, 64.0, 70.0), (3, 3, 3), "guided"),
    ((59.0, 64.0, 70.0), (6, 6, 6), "guided"),
]


def posterior(recording, bounds) -> tuple[np.ndarray, np.ndarray]:
    """Most likely coordinate in px, and the probability that it is wrong: summed over all orders."""
    sets = [recording.plan.fringes[k] for k in recording.plan.sets_along("x")]
    seen = [wrapped_phase(recording.of_set(k), f) for k, f in enumerate(sets)]
    turns = np.array([s.phase for s in seen], float) / (2 * np.pi)
    noise = np.sqrt(
        error_model_of(recording).noise.variance(np.array([s.offset for s in seen]) * recording.grey)
    )
    modulation = np.array([s.modulation for s in seen], float) * recording.grey
    stripes = np.array([f.stripes for f in sets]).reshape(-1, 1, 1)
    gain = np.array([f.phase_noise for f in sets]).reshape(-1, 1, 1) / (2 * np.pi)
    weight = (stripes * modulation / (noise * gain)) ** 2
    total = weight.sum(0)
    ends = (
        (0.0, 1.0)
        if bounds is None
        else tuple((e + 0.5) / WIDTH for e in (bounds["x"].lower, bounds["x"].upper))
    )
    costs, places = [], []
    for order in range(-2, int(np.ceil(stripes.max())) + 3):
        place = (order + turns[-1]) / stripes[-1, 0, 0]
        off = turns - place * stripes
        off = (off - np.floor(off + 0.5)) / stripes
        mean, root = place + (weight * off).sum(0) / total, np.sqrt(total / 2)
        low, high = ends[0] - 0.05 / WIDTH, ends[1] + 0.05 / WIDTH
        share = np.maximum(0.5 * (erfc((low - mean) * root) - erfc((high - mean) * root)), 1e-200)
        costs.append((weight * off**2).sum(0) - (weight * off).sum(0) ** 2 / total - 2 * np.log(share))
        places.append(mean * WIDTH - 0.5)
    cost = np.array(costs)
    best = np.argmin(cost, axis=0)[None]
    least = np.take_along_axis(cost, best, 0)
    place = np.take_along_axis(np.array(places), best, 0)[0]
    return place, 1 - 1 / np.exp(-0.5 * (cost - least)).sum(0)


@pytest.mark.nightly
@pytest.mark.parametrize(("stripes", "steps", "unwrapping"), PLANS)
def test_no_more_wrong_orders_and_few_more_losses_than_theory_demands(stripes, steps, unwrapping) -> None:
    kept, wrong = 0, 0
    for ratio in RATIOS:
        recording, truth, bounds = noisy(stripes, steps, unwrapping, ratio, seed=1000 + ratio)
        decoded = decode(limited(recording, LIMIT), bounds=bounds)
        place, probability = posterior(recording, bounds)
        half = 0.5 * WIDTH / max(stripes)
        is_wrong = np.abs(decoded.u - truth) > half
        kept, wrong = kept + int(decoded.valid.sum()), wrong + int((decoded.valid & is_wrong).sum())
        lost = (probability <= LIMIT) & (np.abs(place - truth) < half) & ~decoded.valid
        assert lost.mean() < 0.01, f"{lost.mean():.4f} lost at B/noise = {ratio}"
    allowed = LIMIT * kept
    assert wrong <= allowed + 4 * np.sqrt(allowed)
