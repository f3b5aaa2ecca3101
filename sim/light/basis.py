"""A basis of few light distributions from which every pattern follows by linear combination."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

PatternLevels = NDArray[np.float32]  # light levels of mirrors or pictures, relative to white


@dataclass(frozen=True, eq=False)
class Basis:
    """Light levels of patterns as linear combinations: `level_n ≈ Σ_c weights[n, c] channels[c]`."""

    weights: NDArray[np.float64]  # (patterns, channels)
    channels: PatternLevels  # (channels, rows, columns) of mirrors, within [0, 1]; the first is white

    def level(self, pattern_index: int) -> PatternLevels:
        # returns (rows, columns)
        weights = self.weights[pattern_index].astype(np.float32)
        return np.asarray(np.tensordot(weights, self.channels, axes=1))


def smallest_basis(levels: PatternLevels, allowed: float) -> Basis:
    # The first channel is white; the others are principal components, shifted and scaled into [0, 1] so that
    # they can be projected.
    # levels (patterns, rows, columns)
    n, shape = len(levels), levels.shape[1:]
    flat = levels.reshape(n, -1)
    mean, covariance = _means_and_covariance(flat)
    energy, vectors = np.linalg.eigh(covariance)
    rank = next(r for r in range(n + 1) if _residual_rms(energy, vectors, n - r) <= allowed)
    loading = vectors[:, n - rank :]
    components = loading.T.astype(np.float32) @ flat
    components -= (loading.T @ mean)[:, None].astype(np.float32)
    low, high = components.min(axis=1), components.max(axis=1)
    components -= low[:, None]
    components /= (high - low)[:, None]
    weights = np.column_stack([mean + loading @ low, loading * (high - low)])
    channels = np.concatenate([np.ones((1, flat.shape[1]), np.float32), components])
    return Basis(weights, channels.reshape(-1, *shape))


def _means_and_covariance(flat: PatternLevels) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute means (n,) and covariance (n, n) of n rows in float64, in blocks that fit the CPU cache."""
    n, count = flat.shape
    total, products = np.zeros(n), np.zeros((n, n))
    for start in range(0, count, 1 << 14):
        part = flat[:, start : start + (1 << 14)].astype(np.float64)
        total += part.sum(axis=1)
        products += part @ part.T
    mean = total / count
    return mean, products / count - np.outer(mean, mean)


def _residual_rms(energy: NDArray[np.float64], vectors: NDArray[np.float64], count: int) -> float:
    """Compute the greatest RMS over patterns of the `count` weakest components."""
    if count == 0:
        return 0.0
    shares = (vectors[:, :count] ** 2) @ np.maximum(energy[:count], 0.0)
    return float(np.sqrt(shares.max()))
