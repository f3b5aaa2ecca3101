"""Fit of the response to frames of uniform grey-level images, region by region, with uncertainties.

The image is a grid of regions. Where light falls unevenly each region has its own gain, but all have the
projector's exponent: their fits must agree, otherwise something else than the response changes the levels.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fpplab.core.conventions import Floats, Image, Map, Mask, full_scale
from fpplab.core.errors import CalibrationError
from fpplab.patterns.limits import PATTERN_LIMITS as LIMITS
from fpplab.patterns.response import Region, Response, fit_response

GRID = 3  # regions along each side of the image (chosen)

MEAN, NOISE, SPREAD, WHITE = range(4)  # rows of the result of `statistics`


def statistics(image: Image | Map, bits: int) -> Floats:
    """Compute mean, noise, variance and saturation of each region of a frame."""
    # image (height, width); returns (4, GRID²)
    return np.stack([_of_region(part / full_scale(bits)) for part in _cut_into_regions(image)], axis=1)


def _of_region(levels: Floats) -> Floats:
    noise = 0.5 * np.mean(np.diff(levels, axis=1) ** 2)
    return np.array([levels.mean(), noise, levels.var(), np.mean(levels >= 1.0)])


def _cut_into_regions(image: Image | Map) -> list[Image | Map]:
    height, width = image.shape
    rows, columns = (np.linspace(0, side, GRID + 1).astype(int) for side in (height, width))
    return [
        image[top:bottom, left:right] for top, bottom in pairwise(rows) for left, right in pairwise(columns)
    ]


@dataclass(frozen=True)
class GreyLevelImages:
    """Statistics of the frames of uniform grey-level images."""

    shown: Floats  # levels shown, as shares of full scale, rising
    statistics: Floats  # `statistics` of the frame of every repeat and level
    dark: Floats  # `statistics` of the frame with the projector off
    pixels: Floats  # number of pixels of each region
    bits: int  # depth of the frames


def pixels_of_regions(image: Image | Map) -> Floats:
    # image (height, width); returns (GRID²,)
    return np.array([float(part.size) for part in _cut_into_regions(image)])


def rounding_variance(spread: Floats) -> Floats:
    """Compute the variance of the error that rounding to integers leaves in a mean."""
    # Rounding errors of equal values are equal, and averaging does not reduce them; values spread over more
    # than half an integer dither them away: `Σ_k exp(-4π² k² s²)/(2π² k²)`, which is 1/12 for s = 0 (Gaussian
    # values).
    k = np.arange(1.0, 41.0)
    terms = np.exp(-4 * np.pi**2 * k**2 * spread[..., None]) / (2 * np.pi**2 * k**2)
    return np.asarray(terms.sum(axis=-1))


class MeanLevels(NamedTuple):
    """Levels averaged over regions of the image, each (L,)."""

    levels: Floats
    sigma: Floats
    is_clipped: Mask


def mean_levels_of_regions(greys: GreyLevelImages, regions: Mask) -> MeanLevels:
    """Average the levels over some regions."""
    # The uncertainty has three parts: the pixels' noise over all pixels and repeats; the scatter of the
    # repeats beyond it (an unsteady lamp), pooled over the levels; and rounding, as far as the noise does not
    # dither it away.
    # regions (GRID²,)
    of_regions, weight = greys.statistics[..., regions], greys.pixels[regions]
    pixels, step = weight.sum(), 1.0 / full_scale(greys.bits)
    means, noise, spread, white = (
        of_regions[:, :, i] @ weight / pixels for i in (MEAN, NOISE, SPREAD, WHITE)
    )
    repeats = len(means)
    of_pixels = np.maximum(noise.mean(axis=0), step**2 / 12) / pixels
    lamp = max(0.0, float(np.mean(means.var(axis=0, ddof=1) - of_pixels))) if repeats > 1 else 0.0
    rounded = spread.mean(axis=0) / step**2
    # Up to 1/4 they may as well be equal, on the edge between two integers; beyond, rounding has added 1/12.
    before = np.where(rounded > 1 / 4, rounded - 1 / 12, 0.0)
    variance = (of_pixels + lamp) / repeats + step**2 * rounding_variance(before)
    return MeanLevels(means.mean(axis=0), np.sqrt(variance), white.mean(axis=0) > LIMITS.max_clipped_share)


def fit_greys(greys: GreyLevelImages) -> Response:
    """Fit the response to the regions that are illuminated and not saturated, together and each alone."""
    # When every illuminated region saturates, its saturated levels are left out instead. Both are named in
    # `Response.left_out`.
    chosen, left_out = _choose_regions(greys)
    response = _fit_response_of_regions(greys, chosen)
    regions = tuple(_fit_region(greys, i) for i in np.flatnonzero(chosen).tolist())
    exponents = np.array([r.g for r in regions])
    spread = float(exponents.std(ddof=1)) if len(regions) > 1 else None
    expected = float(np.sqrt(np.mean([r.sigma_g**2 for r in regions]))) if len(regions) > 1 else None
    if spread is not None and expected is not None:
        _check_agreement(response.g, regions, spread, expected)
    return response.model_copy(
        update={
            "regions": regions,
            "region_spread": spread,
            "region_sigma": expected,
            "dark": _dark_level_and_sigma(greys, chosen),
            "left_out": left_out + response.left_out,
        }
    )


def _choose_regions(greys: GreyLevelImages) -> tuple[Mask, tuple[str, ...]]:
    mean = greys.statistics[:, :, MEAN].mean(axis=0)
    rise = np.ptp(mean, axis=0)
    lit = rise >= LIMITS.min_rise
    clipped = (greys.statistics[:, :, WHITE].mean(axis=0) > LIMITS.max_clipped_share).any(axis=0)
    if not lit.any() and clipped.any():
        raise CalibrationError("the image is saturated from the darkest level on: shorten the exposure")
    if not lit.any():
        raise CalibrationError(
            f"the levels seen do not rise with the levels shown: by {rise.max():.2g} of full scale at most, "
            f"and {LIMITS.min_rise:g} are needed; check that the camera looks at the projector's light and "
            "that the exposure is long enough"
        )
    whole = lit & ~clipped
    left_out = [f"{_name(i)} is dark: it rises by {rise[i]:.2g} of full scale" for i in np.flatnonzero(~lit)]
    if whole.any():
        left_out += [f"{_name(i)} is saturated" for i in np.flatnonzero(lit & clipped)]
    return (whole if whole.any() else lit), tuple(left_out)


def _name(index: int) -> str:
    return f"region {index // GRID + 1}, {index % GRID + 1} (row, column) of {GRID} x {GRID}"


def _fit_response_of_regions(greys: GreyLevelImages, regions: Mask, power_only: bool = False) -> Response:
    mean = mean_levels_of_regions(greys, regions)
    return fit_response(
        greys.shown, mean.levels, mean.sigma, saturated=mean.is_clipped, power_only=power_only
    )


def _fit_region(greys: GreyLevelImages, index: int) -> Region:
    alone = np.arange(GRID**2) == index
    fitted = _fit_response_of_regions(greys, alone, power_only=True)
    return Region(
        row=index // GRID,
        column=index % GRID,
        a=fitted.a,
        b=fitted.b,
        g=fitted.g,
        sigma_g=fitted.sigma[2],
    )


def _check_agreement(g: float, regions: tuple[Region, ...], spread: float, expected: float) -> None:
    if spread <= max(LIMITS.max_spread_g * g, 3 * expected):
        return
    lowest, highest = min(regions, key=lambda r: r.g), max(regions, key=lambda r: r.g)
    raise CalibrationError(
        f"the regions of the image do not agree on one response: g is {lowest.g:.3g} in "
        f"{_name(lowest.row * GRID + lowest.column)} and {highest.g:.3g} in "
        f"{_name(highest.row * GRID + highest.column)}; show an evenly white card without reflections, and "
        "keep "
        "other light steady"
    )


def _dark_level_and_sigma(greys: GreyLevelImages, regions: Mask) -> tuple[float, float]:
    """The level seen with the projector off, and its standard uncertainty."""
    dark = GreyLevelImages(greys.shown[:1], greys.dark[None, None], greys.dark, greys.pixels, greys.bits)
    mean = mean_levels_of_regions(dark, regions)
    return float(mean.levels[0]), float(mean.sigma[0])
