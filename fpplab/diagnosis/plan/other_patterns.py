"""Name images of a plan of sinusoids that are none with equal steps: white, black, Gray code, others."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from fpplab.core.conventions import Floats, Image, phase_steps
from fpplab.diagnosis.plan.limits import GUESS_LIMITS, GuessLimits


def name_other_patterns(
    frames: Sequence[Image], full: int, sizes: Sequence[int] = (), limits: GuessLimits = GUESS_LIMITS
) -> str | None:
    """Say which images are no sinusoids with equal steps, and what they are."""
    # frames (height, width)
    levels = lit_levels(frames, full, limits)
    if levels is None:
        return None
    low, high = levels.min(axis=0), levels.max(axis=0)
    levels = np.asarray((levels - low) / (high - low))
    kinds = _kinds(levels, limits)
    descriptions = [f"{_listed(numbers)} {text}" for text, numbers in _by_description(kinds).items()]
    if descriptions:
        others = [k for k, kind in enumerate(kinds) if kind is not None]
        ranges = ",".join(_range(run) for run in _runs_of_successive_numbers(others))
        return (
            f"{'; '.join(descriptions)}: the plan has sinusoids in their place; describe them as 'gray' or "
            f"'even' sets (docs/how-to/other-codes.md), or leave them out with '--skip {ranges}', where the "
            "sinusoids alone suffice; images count from 0"
        )
    return _describe_unequal_steps(levels, sizes, limits)


def sampled_levels(frames: Sequence[Image], pixels: int) -> Floats:
    """Read the grey levels of about a number of pixels that are spread over the image."""
    # frames (height, width); returns (frames, pixels)
    height, width = frames[0].shape
    step = max(1, int(np.sqrt(height * width / pixels)))
    return np.asarray(np.stack([frame[::step, ::step].ravel() for frame in frames]), np.float64)


def lit_levels(frames: Sequence[Image], full: int, limits: GuessLimits) -> Floats | None:
    """Give the levels (K, P) of pixels that change; None where too few do."""
    # frames (height, width)
    levels = sampled_levels(frames, limits.pixels)
    low, high = levels.min(axis=0), levels.max(axis=0)
    span = high - low
    lit = (span > limits.min_range * full) & (span > 0.3 * np.quantile(span, 0.95)) & (high < full)
    if lit.sum() < limits.pixels // 50:
        return None
    return np.asarray(levels[:, lit])


STRIPES = "black and white stripes, as of Gray code"
DESCRIPTIONS = {
    "white": ("is white", "are white"),
    "black": ("is black", "are black"),
    "binary": (f"has {STRIPES}", f"have {STRIPES}"),
}


def _kinds(levels: Floats, limits: GuessLimits) -> list[str | None]:
    kinds: list[str | None] = []
    is_one_sided = []
    for image in levels:
        bright, dark = float(np.mean(image > 1.0 - limits.near)), float(np.mean(image < limits.near))
        if bright > limits.min_uniform_share:
            kinds.append("white")
        elif dark > limits.min_uniform_share:
            kinds.append("black")
        else:
            kinds.append("binary" if bright + dark > limits.min_binary_share else None)
        is_one_sided.append(min(bright, dark) < limits.min_each_share)
    # Wide fringes on a small part may be bright or dark almost everywhere, as a wide stripe of a code is.
    two_sided = [kind == "binary" and not one for kind, one in zip(kinds, is_one_sided, strict=True)]
    return [
        kind if _is_certain(kind, k, two_sided) or _has_other_neighbour(kinds, k) else None
        for k, kind in enumerate(kinds)
    ]


def _is_certain(kind: str | None, k: int, two_sided: Sequence[bool]) -> bool:
    return kind == "binary" and any(two_sided[max(k - 1, 0) : k + 2])


def _has_other_neighbour(kinds: Sequence[str | None], k: int) -> bool:
    # Of wide fringes on a small part one image may be all dark or bright, but never two neighbours.
    return any(kinds[n] not in (None, kinds[k]) for n in (k - 1, k + 1) if 0 <= n < len(kinds))


def _by_description(kinds: Sequence[str | None]) -> dict[str, list[int]]:
    by_text = {}
    for kind, (singular, plural) in DESCRIPTIONS.items():
        numbers = [k for k, own in enumerate(kinds) if own == kind]
        if numbers:
            by_text[singular if len(numbers) == 1 else plural] = numbers
    return by_text


def _runs_of_successive_numbers(numbers: Sequence[int]) -> list[tuple[int, int]]:
    runs = [list(run) for _, run in groupby(enumerate(numbers), key=lambda pair: pair[1] - pair[0])]
    return [(run[0][1], run[-1][1]) for run in runs]


def _range(run: tuple[int, int]) -> str:
    return f"{run[0]}" if run[0] == run[1] else f"{run[0]}-{run[1]}"


def _listed(numbers: Sequence[int]) -> str:
    runs = ", ".join(map(_range, _runs_of_successive_numbers(numbers)))
    return f"image {runs}" if len(numbers) == 1 else f"images {runs}"


def _describe_unequal_steps(levels: Floats, sizes: Sequence[int], limits: GuessLimits) -> str | None:
    """Sets of sinusoids whose steps are not equal."""
    sentences, measured = [], 0
    for k, (start, count) in enumerate(zip(np.cumsum([0, *sizes]), sizes, strict=False)):
        of_set = levels[start : start + count]
        # Three images fit any steps.
        shifts = measured_phase_shifts(of_set, limits) if count > 3 else None
        measured += shifts is not None
        if shifts is None or not _fits_badly(of_set, limits):
            continue
        expected = np.degrees(phase_steps(count))
        turned = min((shifts, -shifts % 360.0), key=lambda candidate: _worst(candidate, expected))
        if _worst(np.sort(turned), expected) <= limits.max_step_error_deg:
            continue  # equal steps in another order, of which other checks say which images were exchanged
        degrees = ", ".join(f"{shift:.0f}" for shift in turned)
        sentences.append(f"the images of 'fringes[{k}]' have unequal phase steps, at {degrees} degrees")
    if not sentences:
        return None
    # A shift of the image moves the phase of fine fringes most.
    moved = "; or the scene moved, which other sets hide: then take the images again at rest"
    return (
        f"{'; '.join(sentences)}: describe such a set as 'kind: shifted' with these 'shifts_deg', or leave "
        f"images out by '--skip', so that equal steps remain{moved if len(sentences) < measured else ''}"
    )


def _fits_badly(levels: Floats, limits: GuessLimits) -> bool:
    """Whether sinusoids with equal steps leave much more of a set than those with any steps, which fit."""
    changes = levels - levels.mean(axis=0)
    total = float(np.sum(changes**2))
    free = total - float(np.sum(np.linalg.svd(changes, compute_uv=False)[:2] ** 2))
    shift = phase_steps(len(levels))
    waves = np.stack([np.cos(shift), np.sin(shift)]) * np.sqrt(2.0 / len(levels))
    equal = total - float(np.sum((waves @ changes) ** 2))
    return free <= limits.max_free_misfit * total and equal > max(
        limits.min_equal_misfit * total, limits.min_misfit_ratio * free
    )


def _worst(shifts: Floats, expected: Floats) -> float:
    return float(np.max(np.abs((shifts - expected + 180.0) % 360.0 - 180.0)))


def measured_phase_shifts(levels: Floats, limits: GuessLimits = GUESS_LIMITS) -> Floats | None:
    """Find the phase shifts of images that are sinusoids of one number of stripes."""
    # levels (N, P); returns (N,)
    # Offset, cosine and sine span all levels of a pixel, whatever the steps are.
    directions, strength, _ = np.linalg.svd(levels - levels.mean(axis=0), full_matrices=False)
    if np.sum(strength[2:] ** 2) > limits.max_rank_misfit * np.sum(strength**2):
        return None
    basis = np.column_stack([np.ones(len(levels)), directions[:, :2] * strength[:2]])
    # The shifts lie on an ellipse in this plane; pixels of all phases determine its axes.
    inverse = np.linalg.pinv(basis) @ levels
    second = np.cov(inverse[1:])
    x, y = np.linalg.cholesky(second).T @ basis[:, 1:].T
    (across, down, _), *_ = np.linalg.lstsq(
        np.column_stack([2.0 * x, 2.0 * y, np.ones_like(x)]), x**2 + y**2, rcond=None
    )  # steps that are not balanced shift the circle away from the images' mean
    angles = np.degrees(np.arctan2(y - down, x - across))
    return np.asarray((angles - angles[0]) % 360.0)
