"""The probability of a wrong order is right, and pixels above the allowed one are masked, with the cause."""

import numpy as np
import pytest

from fpplab.core.conventions import Image
from fpplab.patterns.plan import MaskRules, Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.phase.alternatives import alternatives_of
from fpplab.phase.bounds import PossibleCoordinates
from fpplab.phase.precision import uncertain_orders
from fpplab.phase.unwrapping import wavelength_sequence
from tests.phase.reference_decoder import decode_axis
from tests.phase.test_fusion import WIDTH, plan_of

HEIGHT = 60
NO_MASKS = MaskRules(modulation_min=0.0, contrast_min=0.0, residual_max=10.0, wrong_order_max=1.0)

CASES = [
    ((1.0, 8.0, 64.0), (3, 3, 3), "hierarchical", 6.0),
    ((49.0, 56.0, 64.0), (6, 6, 6), "heterodyne", 6.0),
    ((12.0, 100.0), (4, 4), "guided", 6.0),
    ((0.95, 6.1, 30.7), (4, 4, 4), "hierarchical", 5.0),
    ((1.0, 12.0), (4, 4), "hierarchical", 7.0),
    ((146.0, 156.0, 167.0), (3, 3, 3), "heterodyne", 17.0),
]
case = pytest.mark.parametrize(("stripes", "steps", "unwrapping", "ratio"), CASES)


def noisy(
    stripes: tuple[float, ...], steps: tuple[int, ...], unwrapping: str, ratio: float, seed: int
) -> tuple[Recording, np.ndarray, dict | None]:
    """Frames of random coordinates with B/noise = ratio, their truth, and bounds for guided unwrapping."""
    plan = plan_of(stripes, steps, unwrapping).model_copy(update={"masks": NO_MASKS})
    random = np.random.default_rng(seed)
    truth = random.uniform(-0.5, WIDTH - 0.5, (HEIGHT, WIDTH))
    frames: list[Image] = []
    for index, step, _ in plan.steps():
        fringe = plan.fringes[index]
        phase = 2 * np.pi * fringe.stripes * (truth + 0.5) / WIDTH - fringe.phase_shifts()[step]
        level = 32000 + 6000 * (np.cos(phase) + random.standard_normal(truth.shape) / ratio)
        frames.append(np.rint(level).astype(np.uint16))
    bounds = None
    if unwrapping == "guided":
        least = np.clip(truth - random.uniform(0, 60, truth.shape), -0.5, None)
        most = np.minimum(least + 60, WIDTH - 0.5)
        bounds = {"x": PossibleCoordinates(least.astype(np.float32), most.astype(np.float32))}
    return Recording(frames, plan, (WIDTH, HEIGHT), 16), truth, bounds


def limited(recording: Recording, limit: float) -> Recording:
    masks = NO_MASKS.model_copy(update={"wrong_order_max": limit})
    plan = recording.plan.model_copy(update={"masks": masks})
    return Recording(recording.frames, plan, recording.projector_size, recording.bits)


def wrong(u: np.ndarray, truth: np.ndarray, plan: Plan) -> np.ndarray:
    return np.abs(u - truth) > 0.5 * WIDTH / plan.finest.stripes


@pytest.mark.whole_after(3)
@case
def test_the_probability_is_the_frequency(stripes, steps, unwrapping, ratio) -> None:
    recording, truth, bounds = noisy(stripes, steps, unwrapping, ratio, seed=31)
    found = decode_axis(recording, "x", bounds)
    seen = np.isfinite(found.coordinate) & (found.wrong_order < 0.2)
    p = found.wrong_order[seen].astype(np.float64)
    is_wrong = wrong(found.coordinate, truth, recording.plan)[seen]
    # The noise is estimated from the frames, to some percent; it stands in the exponent.
    assert is_wrong.sum() == pytest.approx(p.sum(), abs=0.1 * p.sum() + 4 * np.sqrt(p.sum()) + 1)
    assert p.sum() > 5


@pytest.mark.whole_after(3)
@case
def test_the_compiled_mask_is_the_reference_s(stripes, steps, unwrapping, ratio) -> None:
    recording, _, bounds = noisy(stripes, steps, unwrapping, ratio, seed=32)
    all_pixels = decode(recording, bounds=bounds)
    masked = decode(limited(recording, 1e-3), bounds=bounds)
    known = decode_axis(recording, "x", bounds)
    expected = known.wrong_order
    both = all_pixels.valid & np.isfinite(known.coordinate)
    assert both.sum() > 0.999 * all_pixels.valid.sum()
    clear = both & (np.abs(np.log(np.maximum(expected, 1e-30) / 1e-3)) > 0.05)
    # Beside the mask, single pixels are left out that no neighbour agrees with, for their wrong order.
    assert masked.uncertain_order is not None
    isolated = clear & ~masked.valid & (masked.uncertain_order == 0)
    assert isolated.sum() <= 2
    clear &= ~isolated
    np.testing.assert_array_equal(masked.valid[clear], expected[clear] < 1e-3)
    assert 0.02 < np.mean(expected[clear] < 1e-3) < 0.99
    np.testing.assert_array_equal((masked.uncertain_order > 0)[clear], ~masked.valid[clear])
    np.testing.assert_allclose(
        masked.u[clear & masked.valid], known.coordinate[clear & masked.valid], atol=2e-3
    )


def test_the_likeliest_order_is_found_where_steps_lead_elsewhere() -> None:
    recording, truth, _ = noisy((49.0, 56.0, 64.0), (6, 6, 6), "heterodyne", 6.0, seed=35)
    decoded = decode(limited(recording, 1e-4))
    # Exact summation over all orders keeps 91.4 % of such pixels; the steps alone lose every tenth of them.
    assert decoded.valid.mean() > 0.90
    assert (wrong(decoded.u, truth, recording.plan) & decoded.valid).sum() <= 15
    assert np.nanstd((decoded.u - truth) / decoded.sigma) == pytest.approx(1.0, abs=0.05)


def test_a_set_that_noise_cannot_have_moved_so_far_is_still_refused() -> None:
    recording, _, _ = noisy((1.0, 8.0, 64.0), (6, 6, 6), "hierarchical", 40.0, seed=36)
    frames = list(recording.frames)
    # The coarse fringes are shifted by 0.45 of a period of 8 stripes, as by light from the surroundings.
    coarse = noisy((1.0, 8.0, 64.0), (6, 6, 6), "hierarchical", 40.0, seed=36)[0].frames[:6]
    phase = 2 * np.pi * np.arange(6) / 6
    mean = np.mean(coarse, axis=0)
    cos = np.tensordot(np.cos(phase), coarse, 1) / 3
    sin = np.tensordot(np.sin(phase), coarse, 1) / 3
    off = 2 * np.pi * 0.45 / 8
    for k, angle in enumerate(phase):
        level = mean + cos * np.cos(angle - off) + sin * np.sin(angle - off)
        frames[k] = np.rint(level).astype(np.uint16)
    biased = Recording(frames, recording.plan, recording.projector_size, recording.bits)
    assert decode(limited(recording, 1e-4)).valid.mean() > 0.99
    assert decode(limited(biased, 1e-4)).valid.mean() < 0.01


@case
def test_few_wrong_orders_are_kept_and_few_right_ones_lost(stripes, steps, unwrapping, ratio) -> None:
    recording, truth, bounds = noisy(stripes, steps, unwrapping, 1.5 * ratio, seed=33)
    decoded = decode(limited(recording, 1e-4), bounds=bounds)
    kept = decoded.valid
    # At most 1e-4 of 55,000 pixels: 5.5 expected at the very most, 15 are beyond four standard deviations.
    assert (wrong(decoded.u, truth, recording.plan) & kept).sum() <= 15
    assert kept.mean() > 0.9


def test_the_cause_is_the_set_whose_noise_leaves_the_order_open() -> None:
    recording, _, _ = noisy((1.0, 4.0, 64.0), (3, 3, 3), "hierarchical", 15.0, seed=34)
    decoded = decode(limited(recording, 1e-4))
    causes = uncertain_orders(decoded, recording.plan)
    assert causes is not None
    assert causes["x 4 stripes"] > 100
    # Only at the very edge of the projector are the single stripe and its far end confused.
    assert sum(causes.values()) - causes["x 4 stripes"] < 0.01 * decoded.u.size
    assert sum(causes.values()) == (decoded.uncertain_order > 0).sum()


def test_shifts_are_those_that_the_sets_hardly_tell_apart() -> None:
    plan = plan_of((1.0, 8.0, 64.0), (12, 12, 12), "hierarchical")
    found = alternatives_of(plan, wavelength_sequence(plan, "x", "plan"))
    multiples = np.rint(found.shifts * 64).astype(int).tolist()
    assert {1, 8, 64} <= set(multiples)
    assert not {2, 9, 16} & set(multiples)
    # One fine period changes the phase of 8 stripes by 1/8 and of 1 stripe by 1/64.
    np.testing.assert_allclose(found.turns[0], [1 / 64, 1 / 8, 0], atol=1e-12)
    # Its χ²: what no other position explains of it; one set takes up the share of its information.
    variance = 2 / 12 / (2 * np.pi) ** 2
    apart = np.array([1 / 64, 1 / 8, 0.0])
    along = np.array([1.0, 8.0, 64.0]) / np.sqrt(1 + 64 + 4096)
    assert found.separations[0] == pytest.approx((apart @ apart - (apart @ along) ** 2) / variance)
    assert found.separations[-1] == pytest.approx(0.0, abs=1e-9)
    assert found.edge == 1.0
