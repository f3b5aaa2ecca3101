"""Noise and common errors from the frames themselves: response, lamp, rounding, containers."""

import numpy as np
import pytest

from fpplab.core.conventions import phase_steps
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.phase_error import phase_error, relative_harmonics
from fpplab.phase import error_model
from fpplab.phase.common_errors import groups_of
from fpplab.phase.noise import QUANTISATION, level_step, repeated_rounding, robust_mean

PIXELS = 20_000


def fit_errors(*given, **named):
    return error_model.fit_errors(*given, **named)[0]


def sets(*steps):
    return [Sinusoid(axis="x", stripes=8, steps=n) for n in steps]


def waves(generator, *steps, offset=(40, 160), modulation=30.0, g=1.0):
    """Noise-free grey levels (N, P) of each set: all offsets, random phases, exponent g."""
    a = generator.uniform(*offset, PIXELS)
    levels = []
    for n in steps:
        theta = generator.uniform(0, 2 * np.pi, PIXELS) - phase_steps(n)[:, None]
        light = (0.5 + 0.5 * np.cos(theta)) ** g
        levels.append(a + modulation * (2 * light - 1))
    return levels


def noisy(generator, levels, constant, per_level=0.0, gain=0.0, raw_per_grey=1):
    frames = []
    for level in levels:
        lit = level * (1 + gain * generator.standard_normal((len(level), 1)))
        seen = lit + generator.standard_normal(level.shape) * np.sqrt(constant + per_level * lit)
        frames.append(np.clip(np.rint(seen * raw_per_grey), 0, 256 * raw_per_grey - 1).astype(np.uint16))
    return frames


@pytest.mark.parametrize("steps", [(3, 3, 3), (4, 4, 4), (3, 5), (7,), (12, 12, 12)])
@pytest.mark.parametrize(("g", "gain"), [(1.0, 0.0), (1.2, 0.0), (1.0, 0.005)])
def test_noise_is_found_whatever_response_and_lamp_do(steps, g, gain):
    generator = np.random.default_rng(sum(steps))
    frames = noisy(generator, waves(generator, *steps, g=g), 1.5, 0.05, gain)
    noise = fit_errors(frames, sets(*steps), 8).noise
    for level in (50, 100, 150):
        assert noise.variance(level) == pytest.approx(1.5 + 0.05 * level + QUANTISATION, rel=0.1)


@pytest.mark.parametrize(("steps", "freedom"), [((3, 3), 1), ((3, 3, 3), 2), ((5,), 2), ((4, 3, 7), 5)])
def test_as_many_values_tell_the_noise_whatever_the_steps(monkeypatch, steps, freedom):
    """A pixel of N images tells N - 3 after a sinusoid's fit; of sets of three images, their offsets do."""
    taken = []

    def grouped(samples, *rest):
        taken.append(samples[0].shape[1])
        return groups_of(samples, *rest)

    monkeypatch.setattr(error_model, "groups_of", grouped)
    generator = np.random.default_rng(1)
    frames = [np.tile(sample, 7) for sample in noisy(generator, waves(generator, *steps), 1.5)]
    fit_errors(frames, sets(*steps), 8)
    assert 32_000 <= taken[0] * freedom < 48_000


@pytest.mark.parametrize("steps", [(3, 3), (5,), (4, 7)])
def test_pixels_that_are_hardly_modulated_tell_nothing(steps):
    generator = np.random.default_rng(2)
    strong, weak = (waves(generator, *steps, modulation=m) for m in (21.0, 19.0))
    levels = [np.where(np.arange(PIXELS) < 5000, *both) for both in zip(strong, weak, strict=True)]
    for group in groups_of(levels, sets(*steps), modulation_min=20.0):
        seen = np.concatenate([levels[k] for k in group.members])
        np.testing.assert_array_equal(group.images, seen[:, :5000])


def test_moving_things_and_saturation_do_not_disturb_the_noise():
    generator = np.random.default_rng(6)
    (frames,) = noisy(generator, waves(generator, 8), 4.0)
    frames[3, : PIXELS // 20] += 60
    frames[:, -PIXELS // 5 :] = 255
    assert fit_errors([frames], sets(8), 8).noise.variance(100) == pytest.approx(4.0 + QUANTISATION, rel=0.1)


def test_grey_levels_are_those_of_eight_bits():
    generator = np.random.default_rng(7)
    frames = noisy(generator, waves(generator, 12), 1.5**2, raw_per_grey=16)
    assert fit_errors(frames, sets(12), 12).noise.variance(100) == pytest.approx(1.5**2, rel=0.1)


@pytest.mark.parametrize("steps", [(3,), (12,)])
def test_without_evidence_rounding_remains(steps):
    generator = np.random.default_rng(8)
    frames = [f[:, : 50 if len(f) > 3 else None] for f in noisy(generator, waves(generator, *steps), 0.0)]
    errors = fit_errors(frames, sets(*steps), 8)
    assert (errors.noise.constant, errors.noise.per_level) == (QUANTISATION, 0.0)
    assert not errors.phase_error_is_known


@pytest.mark.parametrize("steps", [(3, 3, 3), (3, 3, 12), (4, 4, 4), (6, 6, 6)])
@pytest.mark.parametrize("g", [0.9, 1.033, 1.2])
def test_the_response_is_seen_in_the_frames(steps, g):
    generator = np.random.default_rng(int(1000 * g))
    errors = fit_errors(noisy(generator, waves(generator, *steps, g=g), 1.0), sets(*steps), 8)
    for one, n in zip(errors.sets, steps, strict=True):
        assert one.harmonic_rad == pytest.approx(phase_error(g, n), rel=0.15, abs=5e-4)


def test_a_measured_response_goes_before_what_the_frames_show():
    generator = np.random.default_rng(9)
    errors = fit_errors(
        noisy(generator, waves(generator, 3), 1.0),
        sets(3),
        8,
        harmonics=relative_harmonics(Curve(a=1, b=0, g=1.2)),
    )
    assert errors.sets[0].harmonic_rad == pytest.approx(phase_error(1.2, 3))


@pytest.mark.parametrize("steps", [3, 4, 12])
def test_the_lamp_s_gains_give_their_phase_error(steps):
    """The RMS error of noise-free fringes with these very gains, which least squares found in noisy ones."""
    generator = np.random.default_rng(steps)
    gain = 1 + 0.005 * generator.standard_normal((3, steps, 1))
    clean = waves(generator, steps, steps, steps, offset=(100, 140), modulation=80.0)
    frames = noisy(generator, [k * level for k, level in zip(gain, clean, strict=True)], 1.0)
    errors = fit_errors(frames, sets(steps, steps, steps), 8)
    turn, actual, told = np.exp(1j * phase_steps(steps)), 0.0, 0.0
    for one, k, level in zip(errors.sets, gain, clean, strict=True):
        phasor, seen = turn @ level, turn @ (k * level)
        actual += np.mean(np.angle(seen / phasor) ** 2)
        told += one.variance(level.mean(axis=0) / (2 / steps * np.abs(phasor))).mean()
    assert np.sqrt(told) == pytest.approx(np.sqrt(actual), rel=0.15)


@pytest.mark.parametrize(
    ("bits", "packed"),
    [
        (12, lambda x: 16 * x),
        (16, lambda x: 256 * x),
        (16, lambda x: 257 * x),
        (12, lambda x: x * 4095 // 255),
    ],
)
@pytest.mark.parametrize("constant", [0.05, 1.0])
def test_a_container_deeper_than_its_data_changes_nothing(bits, packed, constant):
    generator = np.random.default_rng(10)
    frames = noisy(generator, waves(generator, 4, 4, offset=(20, 160), modulation=15.0), constant)
    plain = fit_errors(frames, sets(4, 4), 8)
    deep = fit_errors([packed(f.astype(np.uint32)).astype(np.uint16) for f in frames], sets(4, 4), bits)
    scale = float(packed(np.uint32(240))) / 240 / 2 ** (bits - 8)
    for level in (40.0, 100.0, 160.0):
        for name in ("variance", "repeated"):
            before, after = (getattr(e.noise, name)(at) for e, at in ((plain, level), (deep, scale * level)))
            assert np.sqrt(after) == pytest.approx(scale * np.sqrt(before), rel=0.01, abs=1e-3)
    assert packed(np.uint32(255)) >= deep.saturation > packed(np.uint32(254))


def test_a_step_needs_evidence():
    assert level_step(np.array([3, 90, 180], np.uint8)) == 1
    assert level_step(np.array([*range(0, 255, 4), 5], np.uint8)) == 1
    assert level_step(np.arange(7, 255, 4, dtype=np.uint8)) == 4


def test_dark_levels_that_do_not_change_say_nothing_about_noise():
    generator = np.random.default_rng(11)
    bright, dark = noisy(generator, waves(generator, 6), 1.0), noisy(generator, waves(generator, 6), 1.0)
    dark[0][:] = 5
    both = [np.concatenate([bright[0], dark[0]], axis=1)]
    assert fit_errors(both, sets(6), 8).noise.variance(60) == pytest.approx(1 + QUANTISATION, rel=0.1)


@pytest.mark.parametrize("sigma", [0.1, 0.2, 0.3, 0.5])
def test_what_rounding_repeats_is_the_variance_of_the_mean_error(sigma):
    """Levels evenly over a step, each measured many times: by simulation, 1 % of the variance of rounding."""
    level = (np.arange(2000) + 0.5) / 2000
    noise = sigma * np.random.default_rng(13).standard_normal((2000, 500))
    seen = np.rint(level[:, None] + noise)
    repeated = np.var(seen.mean(axis=1) - level) - (seen.var(axis=1).mean() / 500)
    assert repeated_rounding(np.array(sigma**2)) == pytest.approx(repeated, abs=0.003)


@pytest.mark.parametrize("freedom", [1, 2, 9])
def test_the_robust_mean_is_the_mean_without_outliers(freedom):
    variance = np.random.default_rng(14).chisquare(freedom, 50_000) / freedom
    assert robust_mean(variance, freedom, 0.01) == pytest.approx(1.0, abs=0.02)
    variance[::50] = 100.0
    assert robust_mean(variance, freedom, 0.01) == pytest.approx(1.0, abs=0.05)


def test_wide_fringes_do_not_tell_the_lamp_s_gains_by_their_offsets():
    """Light from the rest of the scene that follows one wide fringe would pass for a lamp that flickers."""
    generator = np.random.default_rng(15)
    both = waves(generator, 3, 3, offset=(100, 140), modulation=60.0)
    both[1] += 0.05 * (both[1][0] - both[1].mean(axis=0))
    wide = [Sinusoid(axis="x", stripes=s, steps=3) for s in (16, 1)]
    fine = [Sinusoid(axis="x", stripes=s, steps=3) for s in (16, 12)]
    frames = noisy(generator, both, 1.0)
    assert fit_errors(frames, wide, 8).sets[1].gain_first < 0.005
    assert fit_errors(frames, fine, 8).sets[1].gain_first > 0.01


def test_a_pixel_that_any_set_shows_black_is_not_used_where_enough_are_left() -> None:
    lit = np.full((3, 2 * error_model.NOISE.min_pixels), 50, np.uint8)
    dark = lit.copy()
    dark[0, : error_model.NOISE.min_pixels] = 0
    usable = error_model._find_usable_pixels([dark, lit], 255)
    assert not usable[: error_model.NOISE.min_pixels].any()
    assert usable[error_model.NOISE.min_pixels :].all()
