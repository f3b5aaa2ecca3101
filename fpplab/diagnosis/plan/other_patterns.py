"""Name images of a plan of sinusoids that are none with equal steps: white, black, Gray code, others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from fpplab.core.conventions import Floats, Image, Mask, phase_steps
from fpplab.diagnosis.plan.limits import GUESS_LIMITS, GuessLimits


def name_other_patterns(
    frames: Sequence[Image], full: int, sizes: Sequence[int] = (), limits: GuessLimits = GUESS_LIMITS
) -> str | None:
    """Say which images are no sinusoids with equal steps, and what they are."""
    # frames (height, width)
    levels = _relative_levels(frames, full, limits)
    if levels is None:
        return None
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


def image_kinds(frames: Sequence[Image], full: int, limits: GuessLimits) -> list[str | None] | None:
    """Tell of every image whether it is white, black or of two levels; None for others."""
    # frames (height, width); None where too few pixels change
    levels = _relative_levels(frames, full, limits)
    return None if levels is None else _kinds(levels, limits)


def _relative_levels(frames: Sequence[Image], full: int, limits: GuessLimits) -> Floats | None:
    """Levels (K, P) of pixels that change, from the least to the greatest of each."""
    levels = lit_levels(frames, full, limits)
    if levels is None:
        return None
    low, high = levels.min(axis=0), levels.max(axis=0)
    return np.asarray((levels - low) / (high - low))


def sampled_levels(frames: Sequence[Image], pixels: int) -> Floats:
    """Read the grey levels of about a number of pixels that are spread over the image."""
    # frames (height, width); returns (frames, pixels)
    height, width = frames[0].shape
    step = max(1, int(np.sqrt(height * width / pixels)))
    return np.asarray(np.stack([frame[::step, ::step].ravel() for frame in frames]), np.float64)


def lit_by_projector(span: Floats, limits: GuessLimits) -> Mask:
    """Which pixels see the projector, by the range of their levels."""
    return np.asarray(span > limits.min_lit_share * np.quantile(span, 0.95))


def lit_levels(frames: Sequence[Image], full: int, limits: GuessLimits) -> Floats | None:
    """Give the levels (K, P) of pixels that change; None where too few do."""
    # frames (height, width)
    levels = sampled_levels(frames, limits.pixels)
    low, high = levels.min(axis=0), levels.max(axis=0)
    span = high - low
    lit = (span > limits.min_range * full) & lit_by_projector(span, limits) & (high < full)
    if lit.sum() < limits.pixels // 50:
        return None
    return np.asarray(levels[:, lit])


BINARY = "binary"  # kind of an image of two levels
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


ITERATIONS = 20  # of gains and offsets in turn (chosen)


def describe_changing_brightness(
    frames: Sequence[Image], full: int, sizes: Sequence[int], limits: GuessLimits = GUESS_LIMITS
) -> str | None:
    """Say in which fringe sets frames are sinusoids of different brightness; None where anything else is."""
    # frames (height, width)
    levels = lit_levels(frames, full, limits)
    if levels is None:
        return None
    starts = np.cumsum([0, *sizes])
    fits = {
        k: _BrightnessFit.of(levels[starts[k] : starts[k] + count])
        for k, count in enumerate(sizes)
        if count > 3  # three images fit any brightness
    }
    if not all(fit.is_explained(limits) for fit in fits.values()):
        return None
    changing = [k for k, fit in fits.items() if fit.is_changing(limits)]
    if not changing:
        return None
    worst = max(changing, key=lambda k: fits[k].change)
    return (
        f"the brightness changes from frame to frame, by {100 * fits[worst].change:.0f} % RMS in "
        f"'fringes[{worst}]': a gain and an offset for each frame make them equal; switch the camera's "
        "automatic exposure, gain and contrast off, save images without stretching them to their range, and "
        "record again"
    )


@dataclass(frozen=True, eq=False)
class _BrightnessFit:
    """Sinusoids with equal steps, each frame times a gain and plus an offset."""

    gains: Floats  # (N,), mean 1
    unchanged_misfit: float  # mean square that equal brightness leaves
    misfit: float  # mean square that gains and offsets leave
    variance: float  # of the sinusoids

    @classmethod
    def of(cls, levels: Floats) -> _BrightnessFit:
        # levels (N, P)
        shifts = phase_steps(len(levels))
        waves = np.stack([np.ones_like(shifts), np.cos(shifts), np.sin(shifts)], axis=1)
        gains, offsets = np.ones((len(levels), 1)), np.zeros((len(levels), 1))
        misfits = []
        for _ in range(ITERATIONS):
            plain = waves @ np.linalg.lstsq(waves * gains, levels - offsets, rcond=None)[0]
            misfits.append(float(np.mean((levels - offsets - gains * plain) ** 2)))
            mean = plain.mean(axis=1, keepdims=True)
            changes = plain - mean
            gains = np.sum(changes * levels, axis=1, keepdims=True) / np.sum(
                changes**2, axis=1, keepdims=True
            )
            gains /= gains.mean()
            offsets = levels.mean(axis=1, keepdims=True) - gains * mean
            offsets -= offsets.mean()
        return cls(gains.ravel(), misfits[0], misfits[-1], float(np.mean(np.var(plain, axis=0))))

    @property
    def change(self) -> float:
        """Standard deviation of the gains."""
        return float(np.std(self.gains))

    def is_explained(self, limits: GuessLimits) -> bool:
        """Whether the images are sinusoids but for their brightness."""
        is_possible = self.gains.min() > limits.min_gain
        return bool(is_possible and self.misfit <= limits.max_unexplained * self.variance)

    def is_changing(self, limits: GuessLimits) -> bool:
        """Whether gains and offsets explain most of what equal brightness leaves."""
        is_better = self.unchanged_misfit > limits.min_explained_ratio * self.misfit
        return is_better and self.change > limits.min_gain_change
