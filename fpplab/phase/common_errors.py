"""Errors that are common to all pixels of one phase: harmonics of a bent response, flicker of the lamp.

An image n of a pixel is `A + B cos θ_n` with `θ_n = φ - δ_n`, and besides noise

    e_n = ε_n (A + B cos θ_n) + B Σ_k c_k cos kθ_n,

where the gains ε_n of the lamp are the same for all pixels and so are the harmonics c_k of the response. What
of it lies outside of offset and fringe is seen in the images; since the same few numbers rule all pixels,
least squares find them although noise is greater in any one pixel. They tell what lies inside of the fringe,
where no single pixel shows it: that is the error of its phase.

Three images show nothing beyond offset and fringe. Where all sets have three, the differences of their
offsets are used, to which the third harmonic and the gains contribute.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Mask
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.phase_error import harmonics, phase_error

HARMONICS = (2, 3, 4, 5)
"""Harmonics of the response that are looked for."""

_GAIN, _HARMONIC, _OFFSET = 0.01, 0.1, 10.0
_LEAST_VARIANCE = 1e-3
_LEAST_THIRD = -0.0168
_OUTLIER = 9.0
_PASSES = 2


@dataclass(frozen=True, eq=False)
class CommonErrors:
    """Errors of one fringe set that are common to all of its pixels.

    Attributes
    ----------
    harmonics : ndarray of float64, (4,)
        Amplitudes of `HARMONICS` as shares of the fringe's; NaN where nothing tells them.
    harmonic_rad : float
        RMS phase error in rad that the response causes; NaN where nothing tells it.
    gain_first, gain_second : float
        `|Σ ε_n exp(iδ_n)|` and `|Σ ε_n exp(2iδ_n)|` of the lamp's gains ε_n; NaN where nothing tells them.
    images : int
        Number N of images of the set.
    """

    harmonics: Floats
    harmonic_rad: float
    gain_first: float
    gain_second: float
    images: int

    def variance(self, offset_per_modulation: Floats | float) -> Floats:
        """Compute the mean square phase error, over all phases.

        Parameters
        ----------
        offset_per_modulation : float or ndarray of float64
            A/B of the pixel.

        Returns
        -------
        ndarray of float64
            rad².
        """
        constant, rising = self.terms
        return np.asarray(constant + rising * np.square(offset_per_modulation))

    @property
    def terms(self) -> tuple[float, float]:
        """Mean square phase error in rad²: the constant part, and the factor of (A/B)²."""
        rising = 2.0 * (self.gain_first / self.images) ** 2
        return self.harmonic_rad**2 + 0.5 * (self.gain_second / self.images) ** 2, rising


@dataclass(frozen=True, eq=False)
class Group:
    """Images of the same P pixels that are fitted together: one set, or all sets where each has three.

    Attributes
    ----------
    members : tuple of int
        Indices of the sets.
    images : ndarray of float64, (N, P)
        Their images, one set after the other, in grey levels.
    offset, modulation : ndarray of float64, (N, P)
        A and B of the pixel in the set of each image.
    phasor : ndarray of complex128, (N, P)
        exp(iφ) of the pixel in the set of each image.
    shift : ndarray of float64, (N,)
        Phase shift δ_n of each image.
    seen : ndarray of float64, (N, N)
        Projection on what no fringe fills; common errors and noise are seen in it.
    freedom : int
        Its rank.
    quiet : ndarray of float64, (N, N)
        Projection on what noise alone fills, once the common errors are taken away.
    """

    members: tuple[int, ...]
    images: Floats
    offset: Floats
    modulation: Floats
    phasor: NDArray[np.complex128]
    shift: Floats
    seen: Floats
    freedom: int
    quiet: Floats

    @property
    def membership(self) -> Floats:
        """1 where an image is of a set, (N, S)."""
        count = len(self.members)
        return np.kron(np.eye(count), np.ones((len(self.images) // count, 1)))

    def only(self, kept: Mask) -> Group:
        """Select pixels.

        Parameters
        ----------
        kept : ndarray of bool, (P,)
            Which.

        Returns
        -------
        Group
            The same sets.
        """
        return replace(self, **{name: getattr(self, name)[:, kept] for name in _STACKED})

    def waves(self, shares: Sequence[float]) -> Floats:
        """Compute a sum of harmonics.

        Parameters
        ----------
        shares : sequence of float
            Factors f_k of the harmonics 1, 2, … of amplitude B.

        Returns
        -------
        ndarray of float64, (N, P)
            `B Σ f_k cos kθ_n`.
        """
        total, power = np.zeros(self.images.shape), np.ones(self.phasor.shape, np.complex128)
        for k, share in enumerate(shares, start=1):
            power = power * self.phasor
            if share:
                turn = share * np.exp(-1j * k * self.shift)[:, None]
                total += power.real * turn.real - power.imag * turn.imag
        return np.asarray(self.modulation * total)

    @property
    def fringe(self) -> Floats:
        """The fitted sinusoid `A + B cos θ_n`, (N, P)."""
        return np.asarray(self.offset + self.waves([1.0]))


@dataclass(frozen=True, eq=False)
class Found:
    """What least squares found in a group.

    Attributes
    ----------
    harmonics : ndarray of float64, (4,)
        Shares c_k of `HARMONICS`.
    uncertainty : ndarray of float64, (4,)
        Standard uncertainties of them.
    gains : ndarray of float64, (N,)
        ε_n.
    covariance : ndarray of float64, (N, N)
        Of the gains.
    offsets : ndarray of float64, (N,)
        Offsets of whole sets in grey levels, where sets are compared.
    """

    harmonics: Floats
    uncertainty: Floats
    gains: Floats
    covariance: Floats
    offsets: Floats


def groups_of(samples: Sequence[Floats], fringes: Sequence[FringeSet]) -> list[Group]:
    """Group fringe sets by what shows their errors.

    Parameters
    ----------
    samples : sequence of ndarray of float64, (N, P)
        Grey levels of each set, of the same P pixels in all.
    fringes : sequence of FringeSet
        The sets.

    Returns
    -------
    list of Group
        One for each set of more than three images; if there is none, one for all sets; none for a single set
        of three.
    """
    parts = [_set_group(k, *one) for k, one in enumerate(zip(samples, fringes, strict=True))]
    long = [part for part in parts if part.freedom > 0]
    if long or len(parts) < 2:
        return long
    count = len(parts)
    own = np.kron(np.eye(count), np.full((3, 3), 1.0 / 3.0))
    between = own - np.full((3 * count, 3 * count), 1.0 / (3 * count))
    stacked = {name: np.concatenate([getattr(p, name) for p in parts]) for name in _STACKED}
    # The mean offset: with each set's own, a gain common to all images would seem to explain their noise.
    stacked["offset"] = np.broadcast_to(stacked["offset"].mean(axis=0), stacked["offset"].shape)
    shift = np.concatenate([part.shift for part in parts])
    return [
        Group(tuple(range(count)), **stacked, shift=shift, seen=between, freedom=count - 1, quiet=between)
    ]


_STACKED = ("images", "offset", "modulation", "phasor")


def _set_group(index: int, sample: Floats, fringe: FringeSet) -> Group:
    shift, shape = fringe.phase_shifts(), sample.shape
    inverse = np.linalg.pinv(_waves(shift, 1))
    # Not by BLAS: its threads go on spinning for 25 ms, on the processors that decoding needs next.
    offset, c, s = np.einsum("kn,np->kp", inverse, sample)
    modulation = np.maximum(np.hypot(c, s), 1e-12)
    return Group(
        (index,),
        sample,
        np.broadcast_to(offset, shape),
        np.broadcast_to(modulation, shape),
        np.broadcast_to((c + 1j * s) / modulation, shape),
        shift,
        _beyond(shift, 1),
        len(shift) - 3,
        # Optics lessen harmonics differently where the picture is less sharp.
        _beyond(shift, min(max((len(shift) - 3) // 2, 1), 3)),
    )


def _waves(shift: Floats, highest: int) -> Floats:
    """Offset and harmonics as columns, (N, 1 + 2 highest)."""
    angle = np.outer(shift, np.arange(1, highest + 1))
    return np.concatenate([np.ones((len(shift), 1)), np.cos(angle), np.sin(angle)], axis=1)


def _beyond(shift: Floats, highest: int) -> Floats:
    """Projection on what offset and harmonics do not fill, (N, N)."""
    waves = _waves(shift, highest)
    return np.asarray(np.eye(len(shift)) - waves @ np.linalg.pinv(waves))


def fit_group(group: Group) -> Found:
    """Fit gains and harmonics of a group by least squares, without pixels that noise does not explain.

    Parameters
    ----------
    group : Group
        Images of many pixels.

    Returns
    -------
    Found
        What is common to them.
    """
    waves = [group.waves([0.0] * (k - 1) + [1.0]) for k in HARMONICS]
    shown = [np.einsum("mn,np->mp", group.seen, one) for one in (*waves, group.images)]
    bent, seen, fringe = np.array(shown[:-1]), shown[-1], group.fringe
    power = (seen**2).sum(axis=0)
    for _ in range(_PASSES):
        kept = np.flatnonzero(power <= _OUTLIER * max(float(np.median(power)), 1e-12))
        variance = max(float(power[kept].mean()) / group.freedom, _LEAST_VARIANCE)
        normal, right, prior = _equations(group, bent[:, :, kept], fringe[:, kept], seen[:, kept])
        normal += np.diag(variance / prior**2)
        found = _found(group, np.linalg.solve(normal, right), variance * np.linalg.inv(normal))
        left = seen - np.einsum("k,knp->np", found.harmonics, bent)
        common = found.gains[:, None] * fringe + (group.membership @ found.offsets)[:, None]
        power = ((left - np.einsum("mn,np->mp", group.seen, common)) ** 2).sum(axis=0)
    return found


def _equations(group: Group, bent: Floats, fringe: Floats, seen: Floats) -> tuple[Floats, Floats, Floats]:
    """Normal equations of harmonics, gains and offsets of sets, and how great each of these may be.

    A gain shows as its image in the projection, an offset as all images of its set: since projecting twice
    changes nothing, their products need the projection itself and sums over pixels only.
    """
    shown, total = group.seen @ group.membership, fringe.sum(axis=1)
    harmonic = np.einsum("knp,lnp->kl", bent, bent)
    by_gain = np.einsum("knp,np->kn", bent, fringe)
    by_offset = bent.sum(axis=2) @ group.membership
    gain, gain_by_offset = group.seen * np.einsum("np,mp->nm", fringe, fringe), total[:, None] * shown
    offset = fringe.shape[1] * (group.membership.T @ shown)
    normal = np.block(
        [
            [harmonic, by_gain, by_offset],
            [by_gain.T, gain, gain_by_offset],
            [by_offset.T, gain_by_offset.T, offset],
        ]
    )
    right = np.concatenate(
        [
            np.einsum("knp,np->k", bent, seen),
            np.einsum("np,np->n", fringe, seen),
            group.membership.T @ seen.sum(axis=1),
        ]
    )
    sizes = len(bent), len(fringe), len(group.members)
    return normal, right, np.repeat([_HARMONIC, _GAIN, _OFFSET], sizes)


def _found(group: Group, best: Floats, covariance: Floats) -> Found:
    lamp = slice(len(HARMONICS), len(HARMONICS) + len(group.images))
    return Found(
        best[: lamp.start],
        np.sqrt(np.diag(covariance)[: lamp.start]),
        best[lamp],
        covariance[lamp, lamp],
        best[lamp.stop :],
    )


def noise_power(group: Group, found: Found) -> tuple[Floats, int]:
    """Measure what noise alone leaves in each pixel.

    Of sets of seven images and more, harmonics 2 and 3 are left out pixel by pixel too.

    Parameters
    ----------
    group : Group
        Images of P pixels.
    found : Found
        What is common to them.

    Returns
    -------
    power : ndarray of float64, (P,)
        Sum of squares, in grey levels squared.
    freedom : int
        Its degrees of freedom.
    """
    common = found.gains[:, None] * group.fringe + group.waves([0.0, *found.harmonics])
    rest = group.images - common - (group.membership @ found.offsets)[:, None]
    return (np.einsum("mn,np->mp", group.quiet, rest) ** 2).sum(axis=0), round(np.trace(group.quiet))


def errors_of_sets(
    groups: Sequence[Group], found: Sequence[Found], fringes: Sequence[FringeSet], exponent: float | None
) -> list[CommonErrors]:
    """Tell the common errors of every set, also of those whose own images do not show them.

    Those take the exponent of the response and the scatter of the lamp from the sets that show them.

    Parameters
    ----------
    groups, found : sequence of Group and of Found
        What was fitted.
    fringes : sequence of FringeSet
        All sets.
    exponent : float, optional
        Exponent g between the light wanted and seen, where it has been measured.

    Returns
    -------
    list of CommonErrors
        Of every set.
    """
    bent = {k: _exponent(group, one) for group, one in zip(groups, found, strict=True) for k in group.members}
    sums = {
        k: s for group, one in zip(groups, found, strict=True) for k, s in _gain_sums(group, one, fringes)
    }
    weight = sum(1.0 / u**2 for _, u in bent.values())
    typical = sum(g / u**2 for g, u in bent.values()) / weight if bent else np.nan
    powers = [np.square(one) / fringes[k].images for k, one in sums.items()]
    scatter = np.mean(powers) if powers else np.nan
    result = []
    for k, fringe in enumerate(fringes):
        g = exponent if exponent is not None else bent[k][0] if k in bent else typical
        shares, rad = _response_errors(g, fringe.images)
        unseen = float(np.sqrt(scatter * fringe.images))
        first, second = sums.get(k, (unseen, unseen))
        result.append(CommonErrors(shares, rad, first, second, fringe.images))
    return result


def _gain_sums(
    group: Group, found: Found, fringes: Sequence[FringeSet]
) -> Iterator[tuple[int, tuple[float, float]]]:
    """`|Σ ε_n exp(iδ_n)|` and `|Σ ε_n exp(2iδ_n)|` of each set, beyond what noise makes of them."""
    size = len(group.images) // len(group.members)
    for place, k in enumerate(group.members):
        own = slice(place * size, (place + 1) * size)
        turns = np.exp(1j * np.outer([1, 2], fringes[k].phase_shifts()))
        power = np.abs((turns * found.gains[own]).sum(axis=1)) ** 2
        noise = np.einsum("km,mn,kn->k", turns, found.covariance[own, own], turns.conj()).real
        first, second = np.sqrt(np.maximum(power - noise, 0.0))
        yield k, (float(first), float(second))


def _response_errors(g: float, images: int) -> tuple[Floats, float]:
    if np.isnan(g):
        return np.full(len(HARMONICS), np.nan), np.nan
    amplitudes = harmonics(g, HARMONICS[-1])
    return amplitudes[list(HARMONICS)] / amplitudes[1], phase_error(g, images)


def _exponent(group: Group, found: Found) -> tuple[float, float]:
    """The exponent of the response and its uncertainty, from the harmonic that shows it best.

    Harmonics of a power law are `c_2 = (g - 1)/(g + 2)` and `c_3 = c_2 (g - 2)/(g + 3)` of the fringe.
    """
    if len(group.members) == 1:
        c, u = found.harmonics[0], found.uncertainty[0]
        return float((1.0 + 2.0 * c) / (1.0 - c)), float(3.0 * u / (1.0 - c) ** 2)
    # Offsets show the third only, which is greatest at g = 1.47 and does not tell what lies beyond.
    c, u = max(found.harmonics[1], _LEAST_THIRD), found.uncertainty[1]
    half = 3.0 + 5.0 * c
    root = np.sqrt(max(half**2 - 8.0 * (1.0 - c) * (1.0 - 3.0 * c), 0.0))
    return float((half - root) / (2.0 * (1.0 - c))), float(12.0 * u)
