"""Phases that are biased: by a bent response at three steps, and in wide fringes by the object itself.

The frames are made here, of a projector's picture, its response, a surface, noise and rounding, so that the
true coordinate is known. Stated phase errors are compared with actual ones, and orders that are wrong and
kept are counted.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.ndimage import gaussian_filter

from benchmarks import Result, above, below
from fpplab.core.conventions import TWO_PI, Floats, Image
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode

SEEDS = (8611, 8612, 8613)
WIDTH, SIZE = 912, (400, 560)
GAMMAS = (1.1, 1.3, 1.6, 1.9, 2.2)
NEAR = 0.2
"""Relative difference between stated and actual phase error: 0.8 to 1.25."""
MIN_KEPT, MAX_WRONG = 0.9, 1e-4


def run() -> list[Result]:
    """Measure both kinds on seeds of their own; the baselines are the targets."""
    return [*_of_three_steps(), *_of_biased_sets()]


def _of_three_steps() -> Iterator[Result]:
    for gamma in GAMMAS:
        off, kept = [], []
        for seed in SEEDS:
            decoded, truth = _decoded(seed, [(1, 3), (8, 3), (64, 3)], gamma)
            error = (decoded.u - truth)[decoded.valid]
            actual = np.sqrt(error.var() - np.nanmean(np.square(decoded.sigma)))
            assert decoded.sigma_phase_error is not None
            off.append(abs(np.sqrt(np.nanmean(np.square(decoded.sigma_phase_error))) / actual - 1.0))
            kept.append(decoded.valid.mean())
        yield below(f"three_steps_gamma_{gamma}_stated_off", float(max(off)), "relative", NEAR)
        yield above(f"three_steps_gamma_{gamma}_kept", float(min(kept)), "of pixels", MIN_KEPT)


def _of_biased_sets() -> Iterator[Result]:
    worst: dict[str, float] = {}
    for seed in SEEDS:
        for name, periods in _biases(np.random.default_rng(seed)):
            decoded, truth = _decoded(seed, [(1, 12), (64, 12)], 1.0, TWO_PI / 64 * periods)
            wrong = np.mean(np.abs(decoded.u - truth) > 0.5 * WIDTH / 64)
            worst[name] = max(worst.get(name, 0.0), float(wrong))
            if name == "none":
                yield above(f"unbiased_{seed}_kept", float(decoded.valid.mean()), "of pixels", 0.999)
    for name, wrong in worst.items():
        yield below(f"biased_{name}_wrong_kept", wrong, "of pixels", MAX_WRONG)


def _biases(random: np.random.Generator) -> Iterator[tuple[str, Floats]]:
    """Bias of the set of one stripe in periods of that of 64."""
    v, u = np.mgrid[: SIZE[0], : SIZE[1]].astype(np.float64)
    row, column = random.uniform(0.35, 0.65, 2) * SIZE
    distance = np.hypot(v - row, u - column)
    disc, across = distance < 100.0, (u - column) / SIZE[1]
    smooth, fine = (gaussian_filter(random.standard_normal(SIZE), size) for size in (40, 3))
    smooth, fine = smooth / smooth.std(), fine / fine.std()
    yield "blob", 1.3 * np.exp(-((distance / 90.0) ** 2))
    yield "two_blobs", 1.2 * np.exp(-((distance / 50.0) ** 2)) - np.exp(-(((distance - 180.0) / 30.0) ** 2))
    yield "band", 1.1 * np.exp(-(((v - row) / 25.0) ** 2))
    yield "sphere", 1.2 * np.sqrt(np.clip(1.0 - (distance / 110.0) ** 2, 0.0, None))
    yield "shelf", 1.0 / (1.0 + np.exp((distance - 100.0) / 6.0))
    yield "disc", 0.94 * disc
    yield "object", np.where(disc, 1.0 + 0.25 * smooth, 0.0)
    yield "texture", np.where(disc, 0.6 * fine, 0.0)
    yield "field", 0.5 * smooth
    yield "scaled", 2.4 * across
    yield "none", np.zeros(SIZE)


def _decoded(
    seed: int, sets: Sequence[tuple[float, int]], gamma: float, bias_rad: Floats | float = 0.0
) -> tuple[Decoded, Floats]:
    """Decode frames of a smooth surface, and give the true coordinate; the bias is that of the first set."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[: SIZE[0], : SIZE[1]] / SIZE[1]
    truth = 60.0 + 780.0 * x + 40.0 * np.sin(random.uniform(4, 8) * x + random.uniform(4, 8) * y)
    shade = 0.75 + 0.2 * np.sin(6.0 * x + random.uniform(0, 6)) * np.cos(5.0 * y)
    frames: list[Image] = []
    for k, (stripes, steps) in enumerate(sets):
        for n in range(steps):
            angle = TWO_PI * (stripes * (truth + 0.5) / WIDTH - n / steps) + (bias_rad if k == 0 else 0.0)
            light = (12.0 + 203.0 * (0.5 + 0.5 * np.cos(angle)) ** gamma) * shade
            light += random.standard_normal(SIZE) * np.sqrt(0.4 + 0.008 * light)
            frames.append(np.rint(light).clip(0, 255).astype(np.uint8))
    plan = Plan(fringes=tuple(Sinusoid(axis="x", stripes=s, steps=n) for s, n in sets))
    return decode(Recording(frames, plan, (WIDTH, 1140))), truth
