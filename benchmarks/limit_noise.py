"""Uncertainty of coordinates: what is reported beside the true error, over responses, depths, ink and lamps.

Pixels see a projected fringe at known coordinates, through a response of exponent g, a lamp that flickers and
a sensor with read-out and shot noise. The true error of the decoded coordinates, root mean square over all
pixels and a few repetitions, is divided by the standard uncertainty that is reported, noise and common phase
error together. It should be 1.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from benchmarks import Result, below
from fpplab.core.conventions import Floats, Image, full_scale, phase_of_coordinate, raw_dtype
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode

PROJECTOR = (912, 1140)
CAMERA = (160, 96)
STRIPES = (1.0, 8.0, 64.0)
STEPS = (3, 4, 5, 6, 8, 12)
EXPONENTS = (1.0, 1.1, 1.3)
SEEDS = (71,)
READ, SHOT = 0.5, 0.02
AMBIENT, LIGHT = 0.05, 0.85
KNOWN, UNKNOWN = 1.1, 1.25
"""Greatest allowed ratio of true and reported, or reported and true, with the response known and not."""


@dataclass(frozen=True)
class Bench:
    """A simulated bench."""

    steps: int  # N of every fringe set
    g: float = 1.0  # exponent of the response
    bits: int = 8  # depth of the frames
    ink: float = 1.0  # reflectance of the brightest pixels; the others reflect down to half of it
    flicker: float = 0.0  # relative standard deviation of the light from frame to frame
    exposure: float = 1.0  # exposure, relative to one that saturates nothing


def noise_figures() -> list[Result]:
    """Compare true and reported uncertainty."""
    kinds = {
        "bright": {},
        "ink_10": {"ink": 0.1},
        "flicker": {"flicker": 0.005},
        "ink_10_flicker": {"ink": 0.1, "flicker": 0.005},
    }
    results = []
    for (name, kind), bits in product(kinds.items(), (8, 12)):
        ratios = np.array([ratios_of(Bench(n, g, bits, **kind)) for n, g in product(STEPS, EXPONENTS)])
        off = np.maximum(ratios, 1.0 / ratios).max(axis=0)
        for k, (response, limit) in enumerate((("known", KNOWN), ("unknown", UNKNOWN))):
            results.append(below(f"sigma_{name}_{bits}_bits_response_{response}", off[k], "factor", limit))
    return results


def ratios_of(bench: Bench, seeds: tuple[int, ...] = SEEDS) -> tuple[float, float]:
    """Divide the true error by the reported standard uncertainty."""
    true, reported = np.zeros(2), np.zeros(2)
    for seed in seeds:
        recording, u = simulated(bench, seed)
        for k, one in enumerate((recording, replace(recording, response=None))):
            decoded = decode(one)
            true[k] += np.sum((decoded.u - u)[decoded.valid] ** 2)
            reported[k] += np.sum(decoded.sigma_total[decoded.valid].astype(np.float64) ** 2)
    known, unknown = np.sqrt(true / reported).tolist()
    return known, unknown


def simulated(bench: Bench, seed: int) -> tuple[Recording, Floats]:
    """Simulate the frames of a bench."""
    # returns u (height, width) px
    random = np.random.default_rng([seed, bench.steps])
    shape = CAMERA[::-1]
    # Away from the edges, and evenly over many fringes.
    u = random.uniform(40.0, PROJECTOR[0] - 41.0, shape)
    reflectance = bench.ink * random.uniform(0.5, 1.0, shape)
    plan = Plan(fringes=tuple(Sinusoid(axis="x", stripes=s, steps=bench.steps) for s in STRIPES))
    frames: list[Image] = []
    for index, step, _ in plan.steps():
        fringe = plan.fringes[index]
        light = fringe.wave(phase_of_coordinate(u, fringe.stripes, PROJECTOR[0]), step) ** bench.g
        lamp = 1.0 + bench.flicker * random.standard_normal()
        level = 255.0 * bench.exposure * reflectance * lamp * (AMBIENT + LIGHT * light)
        level += random.standard_normal(shape) * np.sqrt(READ**2 + SHOT * level)
        raw = np.rint(level * 2.0 ** (bench.bits - 8)).clip(0, full_scale(bench.bits))
        frames.append(raw.astype(raw_dtype(bench.bits)))
    response = Curve(a=LIGHT, b=AMBIENT, g=bench.g)
    return Recording(frames, plan, PROJECTOR, bench.bits, response=response), u
