"""How much of an error of form is shared by neighbouring pixels: bent surfaces are, noise is not."""

from __future__ import annotations

import numpy as np

from fpplab.acceptance.results import MeasuredFeature

LEAST_PAIRS = 100
"""Pairs of neighbouring pixels that tell something."""


def shared_variance(measured: MeasuredFeature) -> float | None:
    """Estimate which share of the variance of a feature's errors neighbouring pixels have in common."""
    if measured.pixels is None:
        return None
    pixels, distances = measured.pixels[measured.kept], measured.distances[measured.kept]
    order = np.lexsort((pixels[:, 0], pixels[:, 1]))
    pixels, distances = pixels[order], distances[order]
    beside = (np.diff(pixels[:, 0]) == 1) & (np.diff(pixels[:, 1]) == 0)
    if np.count_nonzero(beside) < LEAST_PAIRS:
        return None
    product = distances[:-1][beside] * distances[1:][beside]
    return float(np.mean(product) / max(float(np.mean(distances**2)), 1e-30))
