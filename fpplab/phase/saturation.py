"""Pixels with saturated samples: least squares over the samples that are left.

Saturated samples say only that the level is high, so they are left out, one by one. What remains is no longer
balanced: noise counts for more, and harmonics of the response, which cancel over all shifts, enter the phase.
Both are computed, for the standard uncertainties of the pixel.
"""

from typing import Any

import numpy as np

from fpplab.core.compiled import kernel_part
from fpplab.phase.limits import NOISE


@kernel_part(error_model="numpy")
def fit_unsaturated(levels: Any, cosine: Any, sine: Any, full: Any, shares: Any, fitted: Any) -> bool:
    # levels (N,); cosine, sine (N,); shares (K,); fitted (6,) rad
    count = total = 0
    c = s = cc = ss = cs = y = yc = ys = 0.0
    for n in range(len(levels)):
        if cosine[n] == 0.0 and sine[n] == 0.0:
            continue
        total += 1
        if levels[n] < full:
            count += 1
            p, q, level = float(cosine[n]), float(sine[n]), float(levels[n])
            c += p
            s += q
            cc += p * p
            ss += q * q
            cs += p * q
            y += level
            yc += level * p
            ys += level * q
    if count < NOISE.min_samples:
        return False
    # The offset eliminated: two equations remain.
    cc, ss, cs = cc - c * c / count, ss - s * s / count, cs - c * s / count
    yc, ys = yc - c * y / count, ys - s * y / count
    determinant = cc * ss - cs * cs
    if determinant <= 1e-9 * total * total:
        return False
    a, b = (ss * yc - cs * ys) / determinant, (cc * ys - cs * yc) / determinant
    offset, power = (y - a * c - b * s) / count, a * a + b * b
    loss = 0.5 * total * (ss * b * b + cc * a * a + 2.0 * cs * a * b) / (determinant * max(power, 1e-30))
    if loss > NOISE.max_saturation_loss:
        return False
    turn, rest, error = np.arctan2(b, a), 0.0, 0.0
    for n in range(len(levels)):
        if (cosine[n] == 0.0 and sine[n] == 0.0) or levels[n] >= full:
            continue
        p, q = float(cosine[n]), float(sine[n])
        rest += (levels[n] - offset - a * p - b * q) ** 2
        theta, bent = turn - np.arctan2(q, p), 0.0
        for k in range(len(shares)):
            bent += shares[k] * np.cos((k + 2) * theta)
        p, q = p - c / count, q - s / count
        # How the phase answers to this sample, per modulation.
        error += bent * (a * (cc * q - cs * p) - b * (ss * p - cs * q)) / determinant
    fitted[0], fitted[1], fitted[2], fitted[3] = offset, a, b, rest / count
    fitted[4], fitted[5] = loss, error / np.sqrt(max(power, 1e-30))
    return True
