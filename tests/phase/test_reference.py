"""The compiled decoder agrees with the NumPy reference, for any plan, noise, depth and response."""

from collections.abc import Iterator

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fpplab.core.conventions import Axis, Image, Lattice
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import MaskRules, Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode, wrapped_phase
from tests.phase.reference_decoder import decode_axis

SIZE = (320, 6)
LENIENT = MaskRules(
    modulation_min=0.0, contrast_min=0.0, residual_max=10.0, disagreement_max=0.5, wrong_order_max=1.0
)


def frames(plan: Plan, noise: float, bits: int, seed: int) -> Iterator[Image]:
    random, full = np.random.default_rng(seed), (1 << bits) - 1
    for index, step, _ in plan.steps():
        level = 0.1 + 0.7 * plan.fringes[index].level(step, SIZE, Lattice.SQUARE)
        level += random.normal(0.0, noise, level.shape)
        yield np.rint(np.clip(level, 0.0, 0.999) * full).astype(np.uint8 if bits == 8 else np.uint16)


@pytest.mark.whole
@settings(deadline=None, max_examples=40)
@given(
    ratios=st.lists(st.floats(1.5, 9), min_size=1, max_size=3),
    steps=st.lists(st.integers(3, 12), min_size=4, max_size=4),
    heterodyne=st.booleans(),
    sign=st.sampled_from([1, -1]),
    origin=st.floats(-5, 5),
    noise=st.floats(0.0, 0.03),
    bits=st.sampled_from([8, 12]),
    seed=st.integers(0, 999),
)
def test_the_compiled_decoder_is_held_to_the_reference(
    ratios: list[float],
    steps: list[int],
    heterodyne: bool,
    sign: int,
    origin: float,
    noise: float,
    bits: int,
    seed: int,
) -> None:
    stripes = [49.0, 56.0, 64.0] if heterodyne else (0.97 * np.cumprod([1.0, *ratios])).tolist()
    fringes = tuple(
        Sinusoid(axis="x", stripes=min(s, 150.0 + k), steps=n, shift_sign=sign, phase_origin_rad=origin)
        for k, (s, n) in enumerate(zip(stripes, steps, strict=False))
    )
    plan = Plan(fringes=fringes, unwrapping="heterodyne" if heterodyne else "hierarchical", masks=LENIENT)
    recording = Recording(list(frames(plan, noise, bits, seed)), plan, SIZE, bits)
    decoded, known = decode(recording), decode_axis(recording, "x")
    compiled, reference = decoded.u, known.coordinate
    # Where one is at the very limit of ambiguity, rounding to float32 may leave the other out.
    assert (np.isnan(compiled) != np.isnan(reference)).mean() < 0.01
    both = np.isfinite(compiled) & np.isfinite(reference)
    off = np.abs(compiled - reference)[both]
    period = SIZE[0] / max(f.stripes for f in fringes)
    assert (off > 0.25 * period).mean() < 0.002  # an order that is a toss-up
    # A set at the very limit of agreement may take part in one and not in the other.
    alike = np.isclose(decoded.sigma, known.sigma, rtol=1e-3)[both]
    assert alike.mean() > 0.995
    np.testing.assert_array_less(off[alike & (off < 0.25 * period)], 2e-3)
    right = both.copy()
    right[both] = alike & (off < 0.25 * period)
    np.testing.assert_allclose(decoded.disagreement[right], known.disagreement[right], rtol=0.02, atol=0.2)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_both_axes_are_the_reference_s(axis: Axis) -> None:
    sets = tuple(
        Sinusoid(axis=a, stripes=s, steps=5) for a, coarse in (("x", 1.0), ("y", 1.0)) for s in (coarse, 2.4)
    )
    plan = Plan(fringes=sets, masks=LENIENT)
    recording = Recording(list(frames(plan, 0.002, 8, 3)), plan, SIZE)
    decoded = decode(recording)
    compiled = decoded.u if axis == "x" else decoded.v
    both = np.isfinite(compiled)
    assert both.mean() > 0.9
    known = decode_axis(recording, axis)
    np.testing.assert_allclose(compiled[both], known.coordinate[both], atol=2e-3)
    if axis == "x":
        np.testing.assert_allclose(decoded.sigma[both], known.sigma[both], rtol=1e-3)


@pytest.mark.whole
@settings(deadline=None, max_examples=15)
@given(
    steps=st.integers(7, 12),
    exposure=st.floats(1.1, 1.7),
    bits=st.sampled_from([8, 12]),
    seed=st.integers(0, 99),
)
def test_saturated_samples_are_left_out_as_by_the_reference(
    steps: int, exposure: float, bits: int, seed: int
) -> None:
    fringes = tuple(Sinusoid(axis="x", stripes=s, steps=steps) for s in (1.0, 8.0))
    plan = Plan(fringes=fringes, masks=LENIENT)
    random, full = np.random.default_rng(seed), (1 << bits) - 1
    shown = []
    for index, step, _ in plan.steps():
        level = exposure * (0.05 + 0.85 * fringes[index].level(step, SIZE, Lattice.SQUARE))
        level += random.normal(0.0, 0.005, level.shape)
        shown.append(np.rint(np.clip(level, 0.0, 1.0) * full).astype(np.uint8 if bits == 8 else np.uint16))
    recording = Recording(shown, plan, SIZE, bits)
    decoded, reference = decode(recording), decode_axis(recording, "x").coordinate
    wrapped = [wrapped_phase(recording.of_set(k), fringes[k], full) for k in range(2)]
    measured = (wrapped[0].peak < full) & (wrapped[1].peak < full) & np.isfinite(reference)
    assert (decoded.valid != measured).mean() < 0.01
    both = decoded.valid & measured
    assert both.any()
    np.testing.assert_allclose(decoded.u[both], reference[both], atol=3e-3)
    truth = np.broadcast_to(np.arange(SIZE[0], dtype=np.float64), both.shape)
    # Clipped samples kept in would be off by up to a tenth of a fringe.
    assert np.quantile(np.abs(decoded.u - truth)[both], 0.99) < 0.8


def test_the_misfit_is_that_of_the_unsaturated_samples() -> None:
    steps, random = 9, np.random.default_rng(6)
    rules = LENIENT.model_copy(update={"residual_max": 0.1})
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=1.0, steps=steps),), masks=rules)
    bright = np.array([plan.fringes[0].level(n, SIZE, Lattice.SQUARE) for n in range(steps)])
    bright = (
        1.1 * (0.05 + 0.85 * bright)
        + random.normal(0.0, 1.0, bright.shape) * np.linspace(0, 0.08, 6)[:, None]
    )
    shown = np.rint(np.clip(bright, 0.0, 1.0) * 255).astype(np.uint8)
    found = wrapped_phase(list(shown), plan.fringes[0], 255)
    shift = 2 * np.pi * np.arange(steps) / steps
    waves = np.stack([np.ones(steps), np.cos(shift), np.sin(shift)], axis=1)
    expected = np.full(SIZE[::-1], np.nan)
    for at in np.argwhere(found.peak < 255):
        level = shown[(slice(None), *at)].astype(float)
        own, level = waves[level < 255], level[level < 255]
        fitted = np.linalg.lstsq(own, level, rcond=None)[0]
        expected[tuple(at)] = np.sqrt(np.mean((level - own @ fitted) ** 2))
    refitted = np.isfinite(expected) & (shown == 255).any(axis=0)
    assert refitted.sum() > 500
    np.testing.assert_allclose(found.misfit[refitted], expected[refitted], rtol=1e-3, atol=1e-2)
    share = (expected / found.modulation)[:, 30:-30]
    clear = refitted[:, 30:-30] & (np.abs(share - 0.1) > 1e-3)
    valid = decode(Recording(list(shown), plan, SIZE)).valid[:, 30:-30]
    np.testing.assert_array_equal(valid[clear], (share < 0.1)[clear])
    assert 0.2 < valid[clear].mean() < 0.8


def test_modulation_is_the_reference_s() -> None:
    plan = Plan(fringes=(Sinusoid(axis="x", stripes=1.0, steps=7),), masks=LENIENT)
    recording = Recording(list(frames(plan, 0.01, 12, 1)), plan, SIZE, 12)
    wrapped = wrapped_phase(*recording.finest()[::-1])
    decoded = decode(recording)
    seen = decoded.valid
    grey = wrapped.modulation[seen] * recording.grey
    np.testing.assert_allclose(decoded.modulation[seen], grey, rtol=1e-4)


def test_errors_that_all_pixels_share_are_the_reference_s_at_any_contrast() -> None:
    """Of a lamp that flickers: they grow with the offset over the modulation, far beyond the noise."""
    random = np.random.default_rng(4)
    plan = Plan(fringes=tuple(Sinusoid(axis="x", stripes=s, steps=8) for s in (1.0, 6.0)), masks=LENIENT)
    contrast = np.linspace(0.25, 0.9, SIZE[1])[:, None]
    images: list[Image] = []
    for index, step, _ in plan.steps():
        fringe = plan.fringes[index].level(step, SIZE, Lattice.SQUARE) - 0.5
        level = (0.45 + 0.8 * contrast * fringe) * (1.0 + random.normal(0.0, 0.02))
        level += random.normal(0.0, 0.001, level.shape)
        images.append(np.rint(np.clip(level, 0.0, 0.999) * 4095).astype(np.uint16))
    recording = Recording(images, plan, SIZE, 12)
    decoded, known = decode(recording), decode_axis(recording, "x")
    both = np.isfinite(decoded.u) & np.isfinite(known.coordinate)
    assert both.mean() > 0.9
    np.testing.assert_allclose(decoded.sigma[both], known.sigma[both], rtol=1e-3)
    by_row = np.nanmedian(np.where(both, known.sigma, np.nan), axis=1)
    assert by_row[0] > 1.5 * by_row[-1]
