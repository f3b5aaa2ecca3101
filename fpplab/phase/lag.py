"""How much of the frame before is left in each frame, as of a slow sensor or a phosphor.

Within a set, a share λ of the frame before leaves sinusoids, only displaced by λ sin(2π/N) rad. The first
frame of a set, however, has the last one of the set before in it, which its own sinusoid does not explain.
Least squares over many pixels find the share there, beside gains and harmonics.
"""

from collections.abc import Sequence

import numpy as np

from fpplab.core.conventions import TWO_PI, Floats
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.phase.common_errors import beyond_fringe, fit_sinusoids
from fpplab.phase.limits import LAG


def lag_share(samples: Sequence[Floats], fringes: Sequence[FringeSet], modulation_min: float) -> float:
    """Share of the frame before that is left in frames; 0 where noise may make it, or nothing shows it."""
    # samples (N, P) grey levels
    total, weight = 0.0, 0.0
    for before, sample, fringe in zip(samples[:-1], samples[1:], fringes[1:], strict=True):
        if fringe.images == 3:
            continue
        share, variance = _share_in_first(before[-1], sample, fringe, modulation_min)
        total, weight = total + share / variance, weight + 1.0 / variance
    if weight == 0.0:
        return 0.0
    share = total / weight
    return share if abs(share) > max(LAG.significance / np.sqrt(weight), LAG.min_share) else 0.0


def _share_in_first(
    before: Floats, sample: Floats, fringe: FringeSet, modulation_min: float
) -> tuple[float, float]:
    offset, c, s = fit_sinusoids(sample, fringe)
    wave, shift = c + 1j * s, fringe.phase_shifts()
    own = beyond_fringe(shift)[0]
    bright = np.abs(wave) >= max(modulation_min, 1.0)
    if bright.sum() < LAG.min_pixels:
        return 0.0, np.inf
    phasor = wave / np.maximum(np.abs(wave), 1e-9)
    # Of the fit, whose noise is independent of what it leaves.
    last = offset + c * np.cos(shift[-1]) + s * np.sin(shift[-1])
    gains = [np.ones_like(offset), offset, c, s]
    bent = [
        part for k in (2, 3) for part in ((wave * phasor ** (k - 1)).real, (wave * phasor ** (k - 1)).imag)
    ]
    terms = np.stack([own[0] * (before - last), *gains, *bent])[:, bright]
    rest = (own @ sample)[bright]
    for _ in range(LAG.fit_passes):
        inverse = np.linalg.pinv(np.einsum("ap,bp->ab", terms, terms), hermitian=True)
        strengths = inverse @ np.einsum("ap,p->a", terms, rest)
        left = rest - strengths @ terms
        kept = np.abs(left) <= LAG.outlier_ratio * np.median(np.abs(left))
        if kept.all():
            break
        terms, rest, left = terms[:, kept], rest[kept], left[kept]
    return float(strengths[0]), float(inverse[0, 0] * np.square(left).mean())


def without_lag(samples: Sequence[Floats], share: float) -> list[Floats]:
    """Frames as they were before a share of the frame before came into each; the first is left as it is."""
    # samples (N, P)
    if share == 0.0:
        return list(samples)
    frames = np.concatenate(samples)
    for n in range(1, len(frames)):
        frames[n] = (frames[n] - share * frames[n - 1]) / (1.0 - share)
    return np.split(frames, np.cumsum([len(sample) for sample in samples])[:-1])


def lag_error_rad(share: float, fringe: FringeSet) -> float:
    """RMS phase error of a set by the frames before, of which the first is another set's."""
    count = fringe.images
    return abs(share) * float(np.hypot(np.sin(TWO_PI / count), np.sqrt(2.0) / count))
