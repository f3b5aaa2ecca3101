"""Errors that are common to all pixels of one phase: harmonics of a bent response, flicker of the lamp.

An image n of a pixel is `A + B cos θ_n` with `θ_n = φ - δ_n`, and besides noise

    e_n = ε_n (A + B cos θ_n) + B Σ_k c_k cos kθ_n,

where the gains ε_n of the lamp are the same for all pixels and so are the harmonics c_k of the response. What
of it lies outside of offset and fringe is seen in the images; since the same few numbers rule all pixels,
least squares find them although noise is greater in any one pixel. They tell what lies inside of the fringe,
where no single pixel shows it: that is the error of its phase.

Three images show nothing beyond offset and fringe. Where all sets have three, the differences of their
offsets are used, to which the third harmonic and the gains contribute, and the response is found by what it
does to their phases (`fpplab.phase.bent_phases`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fpplab.core.conventions import Floats
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.phase_error import harmonic_phase_error, harmonics
from fpplab.phase.bent_phases import exponent_of_phases, exponent_of_second_harmonic
from fpplab.phase.limits import COMMON_ERRORS, NOISE
from fpplab.phase.unwrapping import WavelengthSequence

HARMONICS = (2, 3, 4, 5)  # harmonics of the response that are looked for


@dataclass(frozen=True, eq=False)
class CommonErrors:
    """Errors of one fringe set that are common to all of its pixels."""

    harmonics: Floats  # amplitudes of `HARMONICS` as shares of the fringe's; NaN where nothing tells them
    harmonic_rad: float  # RMS phase error in rad that the response causes; NaN where nothing tells it
    gain_first: float  # `|Σ ε_n exp(iδ_n)|` and `|Σ ε_n exp(2iδ_n)|` of the lamp's gains ε_n
    gain_second: float  # `|Σ ε_n exp(iδ_n)|` and `|Σ ε_n exp(2iδ_n)|` of the lamp's gains ε_n
    images: int  # number N of images of the set
    ripple_rad: float = 0.0  # RMS phase error N times in a period that neighbours show beyond `harmonic_rad`
    lag_rad: float = 0.0  # RMS phase error by what is left of the frames before
    drift_rad: float = 0.0  # RMS phase error, twice in a period, by a picture that walks during the set
    explained: float = 0.0  # mean square of what gains and harmonics leave beside sinusoids, per B²
    scatter: float = 1.0  # variance of the phase beside that of the noise of grey levels
    misfit_scatter: float = 1.0  # the same of what sinusoids leave
    blur_px2: float = 0.0  # variance of the blur in px²; negative where frames are sharpened

    @property
    def misfit(self) -> float:
        """Greatest mean square that the response adds to a pixel's misfit, as a share of B²."""
        # Twice the mean over all phases: at four steps all of a harmonic may fall on its crests.
        return float(np.nan_to_num(np.square(self.harmonics).sum()))

    def variance(self, offset_per_modulation: Floats | float) -> Floats:
        """Compute the mean square phase error, over all phases."""
        constant, rising = self.terms
        return np.asarray(constant + rising * np.square(offset_per_modulation))

    @property
    def terms(self) -> tuple[float, float]:
        """Mean square phase error in rad²: the constant part, and the factor of (A/B)²."""
        rising = 2.0 * (self.gain_first / self.images) ** 2
        flickering = 0.5 * (self.gain_second / self.images) ** 2
        return self.harmonic_rad**2 + self.of_frames + flickering, rising

    @property
    def of_frames(self) -> float:
        """Mean square phase error in rad² by anything but response and light."""
        return self.ripple_rad**2 + self.lag_rad**2 + self.drift_rad**2


@dataclass(frozen=True, eq=False)
class FringeGroup:
    """Images of the same P pixels that are fitted together: one set, or all sets where each has three.

    An image is a linear combination of R features of its pixel: the offset A and, for each of S sets, the
    real and imaginary parts of `B exp(ikφ)` for the harmonics k. All that is asked of many pixels therefore
    follows from sums of products of features and images.
    """

    members: tuple[int, ...]  # indices of the sets
    images: Floats  # their images, one set after the other, in grey levels
    features: Floats  # the offset first, the mean of all sets; then set after set, by harmonic
    shift: Floats  # phase shift δ_n of each image
    visible: Floats  # orthonormal rows that no fringe fills; common errors and noise are seen in them
    quiet: Floats  # orthonormal rows that noise alone fills, once the common errors are taken away

    @property
    def freedom(self) -> int:
        """How much of a pixel's images shows common errors."""
        return len(self.visible)

    @property
    def offset(self) -> Floats:
        """Mean level of each pixel, (P,)."""
        return np.asarray(self.features[0])

    @property
    def phases(self) -> Floats:
        """Phase of each of the S sets as its images show it, in rad, (S, P)."""
        cosine, sine = (self.features[first :: 2 * HARMONICS[-1]] for first in (1, 2))
        return np.asarray(np.arctan2(sine, cosine))

    @cached_property
    def membership(self) -> Floats:
        """1 where an image is of a set, (N, S)."""
        count = len(self.members)
        return np.kron(np.eye(count), np.ones((len(self.images) // count, 1)))

    @cached_property
    def fringe(self) -> Floats:
        """What makes the fitted sinusoids `A + B cos θ_n` of the features, (N, R)."""
        fringe = self._wave(1)
        fringe[:, 0] = 1.0
        return fringe

    @cached_property
    def waves(self) -> Floats:
        """What makes `B cos kθ_n` of the features, for each of `HARMONICS`: (4, N, R)."""
        return np.array([self._wave(k) for k in HARMONICS])

    def _wave(self, k: int) -> Floats:
        wave, images = np.zeros((len(self.shift), len(self.features))), np.arange(len(self.shift))
        column = 2 * k - 1 + 2 * HARMONICS[-1] * self.membership.argmax(axis=1)
        wave[images, column] = np.cos(k * self.shift)
        wave[images, column + 1] = np.sin(k * self.shift)
        return wave

    def combine_without_common_errors(self, weights: Floats, fit: HarmonicsFit) -> Floats:
        """Combine the images by weights, and take off what the common errors add."""
        # weights (F, N); returns (F, P)
        common = fit.gains[:, None] * self.fringe + np.tensordot(fit.harmonics, self.waves, 1)
        offset = weights @ self.membership @ fit.offsets
        return _product(weights, self.images) - _product(weights @ common, self.features) - offset[:, None]


@dataclass(frozen=True, eq=False)
class HarmonicsFit:
    """What least squares found in a group."""

    harmonics: Floats  # shares c_k of `HARMONICS`
    uncertainty: Floats  # standard uncertainties of them
    gains: Floats  # ε_n
    covariance: Floats  # of the gains
    offsets: Floats  # offsets of whole sets in grey levels, where sets are compared


def groups_of(
    samples: Sequence[Floats], fringes: Sequence[FringeSet], modulation_min: float = 0.0
) -> list[FringeGroup]:
    # samples (N, P)
    fitted = [fit_sinusoids(*fringe_set) for fringe_set in zip(samples, fringes, strict=True)]
    long = [k for k, fringe in enumerate(fringes) if fringe.images > 3]
    used = long or range(len(fringes))
    weakest = np.min([np.hypot(fitted[k][1], fitted[k][2]) for k in used], axis=0)
    strong = np.flatnonzero(weakest >= modulation_min)
    if len(strong) < NOISE.min_pixels or (not long and len(fringes) < 2):
        return []
    parts = [set_group(k, samples[k][:, strong], fitted[k][:, strong], fringes[k]) for k in used]
    if long:
        return parts
    count = len(parts)
    own = np.kron(np.eye(count), np.full((3, 3), 1.0 / 3.0))
    between = _orthonormal_rows(own - np.full((3 * count, 3 * count), 1.0 / (3 * count)))
    # The mean offset: with each set's own, a gain common to all images would seem to explain their noise.
    offset = np.mean([part.offset for part in parts], axis=0)
    features = np.concatenate([offset[None], *(part.features[1:] for part in parts)])
    images = np.concatenate([part.images for part in parts])
    shift = np.concatenate([part.shift for part in parts])
    return [FringeGroup(tuple(used), images, features, shift, visible=between, quiet=between)]


def show_common_errors(fringes: Sequence[FringeSet]) -> bool:
    """Return whether images of these fringe sets show common errors, given enough pixels."""
    return any(fringe.images > 3 for fringe in fringes) or (
        len(fringes) > 1 and any(fringe.stripes >= COMMON_ERRORS.min_stripes for fringe in fringes)
    )


def fit_sinusoids(sample: Floats, fringe: FringeSet) -> Floats:
    # sample (N, P); returns (3, P)
    return _product(np.linalg.pinv(_waves(fringe.phase_shifts(), 1)), sample)


def fringe_levels(fitted: Floats, shift: Floats) -> tuple[Floats, Floats]:
    """Compute the images of fitted sinusoids, and their derivatives by the phase."""
    # fitted (3, P); shift (N,) rad; returns (N, P)
    offset, cosine, sine = fitted
    levels = offset + np.outer(np.cos(shift), cosine) + np.outer(np.sin(shift), sine)
    return levels, np.outer(np.sin(shift), cosine) - np.outer(np.cos(shift), sine)


def set_group(index: int, sample: Floats, fitted: Floats, fringe: FringeSet) -> FringeGroup:
    shift, (offset, c, s) = fringe.phase_shifts(), fitted
    wave = c + 1j * s
    phasor = wave / np.maximum(np.abs(wave), 1e-12)
    features = np.empty((1 + 2 * HARMONICS[-1], sample.shape[1]))
    features[0] = offset
    for k in range(HARMONICS[-1]):
        features[1 + 2 * k], features[2 + 2 * k] = wave.real, wave.imag
        wave *= phasor
    # Optics lessen harmonics differently where the picture is less sharp.
    highest = min(max((len(shift) - 3) // 2, 1), 3)
    return FringeGroup(
        (index,),
        sample,
        features,
        shift,
        _orthonormal_rows(beyond_fringe(shift)),
        _orthonormal_rows(beyond_fringe(shift, highest)),
    )


def _waves(shift: Floats, highest: int) -> Floats:
    """Offset and harmonics as columns, (..., N, 1 + 2 highest)."""
    angle = shift[..., None] * np.arange(1, highest + 1)
    return np.concatenate([np.ones_like(shift)[..., None], np.cos(angle), np.sin(angle)], axis=-1)


def beyond_fringe(shift: Floats, highest: int = 1) -> Floats:
    """Give the projection that takes offset and fringe off the images of a pixel."""
    # shift (..., N) rad; returns (..., N, N); orthonormal waves also bear shifts that are nearly alike
    waves = np.linalg.qr(_waves(shift, highest))[0]
    return np.asarray(np.eye(shift.shape[-1]) - waves @ np.swapaxes(waves, -1, -2))


def _orthonormal_rows(projection: Floats) -> Floats:
    """Orthonormal rows that span what a symmetric projection keeps."""
    kept, vectors = np.linalg.eigh(projection)
    return np.asarray(vectors[:, kept > 0.5].T)


def _product(few: Floats, many: Floats) -> Floats:
    """`few @ many`, not by BLAS: its threads spin for 25 ms afterwards, on processors that decoding needs."""
    return np.asarray(np.einsum("mn,np->mp", few, many))


def fit_group(group: FringeGroup) -> HarmonicsFit:
    """Fit gains and harmonics of a group by least squares, without pixels that noise does not explain."""
    max_pixels = COMMON_ERRORS.sample_pixels * len(group.members) ** 2
    every = slice(None, None, math.ceil(group.images.shape[1] / max_pixels))
    group = replace(group, images=group.images[:, every], features=group.features[:, every])
    terms = np.concatenate([group.features, group.images, np.ones((1, group.images.shape[1]))])
    power = np.square(_product(group.visible, group.images)).sum(axis=0)
    for _ in range(COMMON_ERRORS.fit_passes):
        kept = power <= COMMON_ERRORS.outlier_ratio * max(float(np.median(power)), 1e-12)
        variance = max(float(power[kept].mean()) / group.freedom, COMMON_ERRORS.min_variance)
        chosen = terms[:, kept]
        normal, right, prior = _equations(group, np.einsum("ap,bp->ab", chosen, chosen))
        # Not by `inv`, whose threads spin as well.
        strength, vectors = np.linalg.eigh(normal + np.diag(variance / prior**2))
        inverse = (vectors / strength) @ vectors.T
        fit = _found(group, inverse @ right, variance * inverse)
        power = np.square(group.combine_without_common_errors(group.visible, fit)).sum(axis=0)
    return fit


def _equations(group: FringeGroup, sums: Floats) -> tuple[Floats, Floats, Floats]:
    """Normal equations of harmonics, gains and offsets of sets, and how great each of these may be."""
    # `sums` are those over pixels of the products of features, images and 1, (R + N + 1, R + N + 1).
    count = len(group.features)
    features, of_images, totals = sums[:count, :count], sums[count:-1, :count], sums[-1]
    members, fringe, visible = group.membership, group.fringe, group.visible.T @ group.visible
    shown, bent, total = visible @ members, visible @ group.waves, fringe @ totals[:count]
    summed = bent @ features
    harmonic = np.tensordot(summed, bent, ((1, 2), (1, 2)))
    by_gain = (summed * fringe).sum(axis=2)
    by_offset = bent @ totals[:count] @ members
    gain, gain_by_offset = visible * (fringe @ features @ fringe.T), total[:, None] * shown
    offset = totals[-1] * (members.T @ shown)
    normal = np.block(
        [
            [harmonic, by_gain, by_offset],
            [by_gain.T, gain, gain_by_offset],
            [by_offset.T, gain_by_offset.T, offset],
        ]
    )
    seen_images = visible @ of_images
    right = np.concatenate(
        [np.tensordot(bent, seen_images, 2), (seen_images * fringe).sum(axis=1), shown.T @ totals[count:-1]]
    )
    sizes = len(bent), len(fringe), len(group.members)
    priors = COMMON_ERRORS.harmonic_prior, COMMON_ERRORS.gain_prior, COMMON_ERRORS.offset_prior_grey
    return normal, right, np.repeat(priors, sizes)


def _found(group: FringeGroup, best: Floats, covariance: Floats) -> HarmonicsFit:
    lamp = slice(len(HARMONICS), len(HARMONICS) + len(group.images))
    return HarmonicsFit(
        best[: lamp.start],
        np.sqrt(np.diag(covariance)[: lamp.start]),
        best[lamp],
        covariance[lamp, lamp],
        best[lamp.stop :],
    )


def noise_power(group: FringeGroup, fit: HarmonicsFit) -> tuple[Floats, int]:
    """Measure what noise alone leaves in each pixel."""
    # Of sets of seven images and more, harmonics 2 and 3 are left out pixel by pixel too.
    # returns power (P,)
    return np.square(group.combine_without_common_errors(group.quiet, fit)).sum(axis=0), len(group.quiet)


def explained_misfit(group: FringeGroup, fit: HarmonicsFit) -> float:
    """Mean square per degree of freedom that gains and harmonics leave beside sinusoids, over B²."""
    common = fit.gains[:, None] * group.fringe + np.tensordot(fit.harmonics, group.waves, 1)
    power = np.square(_product(group.visible @ common, group.features)).mean()
    return float(power / max(np.square(group.features[1:3]).sum(axis=0).mean(), 1e-12))


def errors_of_sets(
    groups: Sequence[FringeGroup],
    fits: Sequence[HarmonicsFit],
    fringes: Sequence[FringeSet],
    harmonics: Floats | None,
    sequences: Sequence[WavelengthSequence] = (),
) -> list[CommonErrors]:
    """Compute the common errors of every set, also of those whose own images do not show them."""
    # Those take the exponent of the response and the scatter of the lamp from the sets that show them.
    # harmonics (K,)
    bent = {
        k: exponent
        for group, fit in zip(groups, fits, strict=True)
        for exponent in [_exponent(group, fit, fringes, sequences)]
        for k in group.members
    }
    sums = {k: s for group, fit in zip(groups, fits, strict=True) for k, s in _gain_sums(group, fit, fringes)}
    weight = sum(1.0 / u**2 for _, u in bent.values())
    typical = sum(g / u**2 for g, u in bent.values()) / weight if bent else np.nan
    powers = [np.square(fit) / fringes[k].images for k, fit in sums.items()]
    scatter = np.mean(powers) if powers else np.nan
    result = []
    misfits = {g.members[0]: explained_misfit(g, fit) for g, fit in zip(groups, fits, strict=True)}
    for k, fringe in enumerate(fringes):
        relative = (
            harmonics if harmonics is not None else _power_law_harmonics(bent[k][0] if k in bent else typical)
        )
        shares, rad = relative[list(HARMONICS)], harmonic_phase_error(relative, fringe.images)
        unseen = float(np.sqrt(scatter * fringe.images))
        first, second = sums.get(k, (unseen, unseen))
        misfit = misfits.get(k, 0.0)
        result.append(CommonErrors(shares, rad, first, second, fringe.images, explained=misfit))
    return result


def _gain_sums(
    group: FringeGroup, fit: HarmonicsFit, fringes: Sequence[FringeSet]
) -> Iterator[tuple[int, tuple[float, float]]]:
    """`|Σ ε_n exp(iδ_n)|` and `|Σ ε_n exp(2iδ_n)|` of each set, less what noise makes of them."""
    # Zero where noise alone makes as much of them once in a thousand times. Where offsets are compared, wide
    # fringes prove nothing: light from the rest of the scene changes as slowly as they do.
    size = len(group.images) // len(group.members)
    for place, k in enumerate(group.members):
        if len(group.members) > 1 and fringes[k].stripes < COMMON_ERRORS.min_stripes:
            continue
        own = slice(place * size, (place + 1) * size)
        turns = np.exp(1j * np.outer([1, 2], fringes[k].phase_shifts()))
        power = np.abs((turns * fit.gains[own]).sum(axis=1)) ** 2
        noise = np.einsum("km,mn,kn->k", turns, fit.covariance[own, own], turns.conj()).real
        first, second = np.sqrt(np.where(power > COMMON_ERRORS.gain_significance * noise, power - noise, 0.0))
        yield k, (float(first), float(second))


def _power_law_harmonics(g: float) -> Floats:
    """Harmonics relative to the fringe; NaN where g is."""
    if np.isnan(g):
        return np.full(COMMON_ERRORS.highest_harmonic + 1, np.nan)
    amplitudes = harmonics(g, COMMON_ERRORS.highest_harmonic)
    return np.asarray(amplitudes / amplitudes[1])


def _exponent(
    group: FringeGroup,
    fit: HarmonicsFit,
    fringes: Sequence[FringeSet],
    sequences: Sequence[WavelengthSequence],
) -> tuple[float, float]:
    """The exponent of the response and its uncertainty among groups, from what shows it best."""
    # Harmonics of a power law are `c_2 = (g - 1)/(g + 2)` and `c_3 = c_2 (g - 2)/(g + 3)` of the fringe.
    if len(group.members) == 1:
        c, u = fit.harmonics[0], fit.uncertainty[0]
        return exponent_of_second_harmonic(float(c)), float(3.0 * u / (1.0 - c) ** 2)
    origins = np.array([fringe.demodulation().origin_rad for fringe in fringes])
    if not math.isnan(exponent := exponent_of_phases(group.phases, origins, sequences)):
        return exponent, 1.0  # of the only group: it is weighed against none
    # Offsets show the third only, which is greatest at g = 1.47 and does not show what lies beyond.
    c = max(fit.harmonics[1], COMMON_ERRORS.min_third_harmonic)
    half = 3.0 + 5.0 * c
    root = np.sqrt(max(half**2 - 8.0 * (1.0 - c) * (1.0 - 3.0 * c), 0.0))
    return float((half - root) / (2.0 * (1.0 - c))), 1.0
