"""Coordinates beside the Cramér-Rao bound of all their images, in pixels and in depth."""

import numpy as np

from benchmarks import Result, below
from fpplab.core.conventions import TWO_PI, Floats
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode

WIDTH, HEIGHT, LEVEL, MODULATION, BITS = 912, 400, 32000.0, 20000.0, 16
DEPTH_UM_PER_PX = 1371.0
"""Depth for a projector pixel in the demonstration's geometry."""
NOISE = 0.0062
"""Of an image in units of the fringes' amplitude, with which the demonstration's 36 images err by 7.8 µm."""
WITHIN = 1.03
PLANS = {
    "36_images": ("hierarchical", (1.0, 8.0, 64.0), (12, 12, 12)),
    "18_images": ("hierarchical", (1.0, 19.03, 167.2), (3, 3, 12)),
    "18_heterodyne": ("heterodyne", (144.0, 155.0, 167.0), (6, 6, 6)),
    "9_heterodyne": ("heterodyne", (146.0, 156.0, 167.0), (3, 3, 3)),
}
NINE_UM, ALL_UM = 4.3, 8.0


def decoding_figures() -> list[Result]:
    """Decode noisy frames of known coordinates, each plan with a seed of its own."""
    results, depths = [], {}
    for seed, (name, (unwrapping, stripes, steps)) in enumerate(PLANS.items(), start=20261123):
        fringes = tuple(Sinusoid(axis="x", stripes=s, steps=n) for s, n in zip(stripes, steps, strict=True))
        plan = Plan(fringes=fringes, unwrapping=unwrapping)
        scatter = float(np.nanstd(_errors(plan, seed)))
        results.append(below(f"scatter_{name}", scatter, "px", WITHIN * NOISE * _bound(stripes, steps)))
        depths[name] = scatter * DEPTH_UM_PER_PX
    depth = [("36_images", ALL_UM), ("9_heterodyne", NINE_UM)]
    return [*results, *(below(f"depth_{name}", depths[name], "um", limit) for name, limit in depth)]


def _bound(stripes: tuple[float, ...], steps: tuple[int, ...]) -> float:
    """Cramér-Rao bound of a coordinate in px per unit of noise over amplitude, from all sets."""
    information = sum(n / 2 * (TWO_PI * s / WIDTH) ** 2 for s, n in zip(stripes, steps, strict=True))
    return float(1 / np.sqrt(information))


def _errors(plan: Plan, seed: int) -> Floats:
    random = np.random.default_rng(seed)
    truth = random.uniform(5.0, WIDTH - 6.0, (HEIGHT, WIDTH))
    frames = []
    for index, step, _ in plan.steps():
        fringe = plan.fringes[index]
        phase = TWO_PI * fringe.stripes * (truth + 0.5) / WIDTH - fringe.phase_shifts()[step]
        level = LEVEL + MODULATION * (np.cos(phase) + random.normal(0.0, NOISE, truth.shape))
        frames.append(np.rint(level).astype(np.uint16))
    return np.asarray(decode(Recording(frames, plan, (WIDTH, HEIGHT), BITS)).u - truth)
