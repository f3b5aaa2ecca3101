"""Light by way of other surfaces: points that stand where there is nothing, and what it costs the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import uniform_filter

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Axis, Floats, Mask
from fpplab.diagnosis.catalogue import FaultCause, Finding
from fpplab.diagnosis.sample import MEDIAN, FrameSample
from fpplab.diagnosis.wrong_plan import LEAST_CHANGE, changes_along_image

MOST_MIRRORED = 0.03
"""Greatest share of the image with fringes in which the coordinate runs backwards."""

BLOCK = 24
"""Side in pixels of the sample of the blocks in which the direction is judged: harmonics average out."""

LEAST_KNOWN, FEWEST_BLOCKS = 0.25, 8
"""Least share of a block's pixels whose coordinate is known, and fewest blocks that are judged."""

SIGMAS = 3.0
"""How many standard uncertainties the change in a block is below zero."""

SMOOTHED = 17
"""Pixels of the sample over which the contrast of the fine fringes beside the wide ones is averaged."""

USELESS_MIRRORED, USELESS_HARM = 0.3, 13.0
"""Share that runs backwards, and error of the phase beside its noise, from which on points are of no use."""


def with_mirrors(findings: Sequence[Finding], sample: FrameSample, calibration: Calibration) -> list[Finding]:
    """Look for mirrored light too, and tell where light by way of other surfaces makes points useless."""
    cause = FaultCause.INTERREFLECTION
    others = [one for one in findings if one.cause is not cause]
    backward = {axis: runs_backward(sample, calibration, axis) for axis in sample.coordinates}
    share = max((part for _, part in backward.values()), default=0.0)
    seen = [one for one in findings if one.cause is cause]
    if share > MOST_MIRRORED:
        words = (
            f"in {100 * share:.0f} % of the image with fringes the coordinate runs backwards (at most "
            f"{100 * MOST_MIRRORED:g} %), as where light comes by way of a face that mirrors"
        )
        seen.append(Finding(cause, words, share / MOST_MIRRORED))
    if not seen:
        return others
    worst = max(seen, key=lambda one: one.excess)
    harm = max((_harm(sample, axis, where) for axis, (where, _) in backward.items()), default=0.0)
    ruins = share >= USELESS_MIRRORED or harm >= USELESS_HARM
    more = f"; it makes errors some {harm:.0f} times those of noise" if np.isfinite(harm) and ruins else ""
    return [*others, replace(worst, evidence=worst.evidence + more, ruins_points=ruins)]


def runs_backward(sample: FrameSample, calibration: Calibration, axis: Axis) -> tuple[Mask, float]:
    """Find where the coordinate runs against the calibration.

    No surface that both devices see shows that, but its image in another surface does.
    """
    shares = changes_along_image(sample.coordinates[axis], calibration, axis, sample.step)
    height, width = sample.spread.shape[1:]
    rows, columns = (-(-n // BLOCK) for n in (height, width))
    whole = np.full((rows * BLOCK, columns * BLOCK), np.nan)
    whole[: shares.shape[0], : shares.shape[1]] = shares
    blocks = whole.reshape(rows, BLOCK, columns, BLOCK).transpose(0, 2, 1, 3).reshape(rows, columns, -1)
    used = np.isfinite(blocks).mean(axis=2) >= LEAST_KNOWN
    back = np.zeros(used.shape, bool)
    if used.sum() >= FEWEST_BLOCKS:
        back[used] = _is_backward(blocks[used])
    where = np.repeat(np.repeat(back, BLOCK, axis=0), BLOCK, axis=1)[:height, :width]
    return where, float(back.sum() / max(used.sum(), 1))


def _is_backward(blocks: Floats) -> Mask:
    """Whether the typical change in each block (B, N) is clearly below zero."""
    middle = np.nanmedian(blocks, axis=1)
    scatter = np.nanmedian(np.abs(blocks - middle[:, None]), axis=1) / MEDIAN
    # The uncertainty of a median is 1.25 times that of a mean.
    doubt = 1.25 * scatter / np.sqrt(np.isfinite(blocks).sum(axis=1))
    return np.asarray(middle < -np.maximum(LEAST_CHANGE, SIGMAS * doubt))


def _harm(sample: FrameSample, axis: Axis, backward: Mask) -> float:
    """Typical error of the phase of the finest fringes beside its noise.

    Other light of the same fringes with another phase adds to them here and takes from them there, and
    shifts their phase by as much. Points that mirrored light has made are wrong altogether.
    """
    plan, used = sample.recording.plan, sample.measured
    sets = [k for k, fringe in enumerate(plan.fringes) if fringe.axis == axis]
    wide, finest = min(sets, key=lambda k: plan.fringes[k].stripes), plan.finest_set(axis)
    if wide == finest or not used.any():
        return 0.0
    fine, coarse = sample.fits[finest], sample.fits[wide]
    contrast = np.where(used, fine.modulation / np.where(used, coarse.modulation, 1.0), 0.0)
    known = np.maximum(uniform_filter(used.astype(np.float64), SMOOTHED), 1e-9)
    off = np.abs(contrast * known / np.maximum(uniform_filter(contrast, SMOOTHED), 1e-9) - 1.0)
    return float(np.median(np.where(backward, np.inf, off)[used])) / MEDIAN / sample.phase_noise(finest)
