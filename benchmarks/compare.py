"""The symmetric mean Chamfer distance against scipy's tree on one thread."""

import time
from statistics import median

import numpy as np
from scipy.spatial import cKDTree

from benchmarks import Result
from fpplab.comparison import smcd
from fpplab.core.conventions import Floats
from fpplab.core.errors import DataError

POINTS = 1_000_000
ROUNDS = 3
AGREEMENT = 1e-9


def run() -> list[Result]:
    """Measure seconds for the SMCD of 1 M against 1 M points, product and baseline in turn, medians."""
    random = np.random.default_rng(0)
    a, b = _surface(random, 0.03), _surface(random, 0.0)
    smcd(a[:1000], b[:1000])  # compiles
    fast, slow = [], []
    for _ in range(ROUNDS):
        start = time.perf_counter()
        value = smcd(a, b)
        middle = time.perf_counter()
        expected = _by_tree(a, b)
        fast.append(middle - start)
        slow.append(time.perf_counter() - middle)
        if not abs(value - expected) <= AGREEMENT * expected:
            raise DataError(f"compare_vs_ckdtree: {value!r} mm instead of the baseline's {expected!r} mm")
    return [Result("compare_vs_ckdtree", median(fast), "s", median(slow), median(slow) / median(fast))]


def _surface(random: np.random.Generator, noise_mm: float) -> Floats:
    """Points at random places of a waved surface of the artefacts' size, in mm."""
    x, y = random.uniform(-45.0, 45.0, POINTS), random.uniform(-35.0, 35.0, POINTS)
    z = 450.0 + 5.0 * np.sin(x / 5.0) * np.cos(y / 7.0) + random.normal(0.0, noise_mm, POINTS)
    return np.stack([x, y, z], axis=1)


def _by_tree(a: Floats, b: Floats) -> float:
    there, _ = cKDTree(b).query(a)
    back, _ = cKDTree(a).query(b)
    return float(there.mean() + back.mean()) / 2.0
