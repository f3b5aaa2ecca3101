"""What the compiled decoder reads and writes, as tuples of arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Recipe(NamedTuple):
    """Everything that the compiled decoder needs to know about frames, plan, rules and noise.

    F is the padded number of frames, S of fringe sets, R of synthetic wavelengths over both axes.

    Attributes
    ----------
    addresses : ndarray of uintp, (F,)
        Address of every frame's first pixel.
    weights : ndarray of float32, (F, 3)
        Weights of every frame for sine, cosine and mean, with the grey scale in them.
    first : ndarray of int64, (S + 1,)
        Where each set starts among the F frames.
    origin : ndarray of float32, (S,)
        Phase origin of each set, in turns.
    coefficients : ndarray of float32, (R, S)
        Integer combination of phases of each synthetic wavelength, x's before y's, coarse to fine.
    stripes : ndarray of float32, (R,)
        Stripes of each synthetic wavelength.
    trust : ndarray of float32, (R,)
        Weight of each wavelength's squared disagreement with the one before, see `WavelengthSequence.trust`.
    wavelengths : ndarray of int64, (3,)
        Where each axis starts among the R wavelengths.
    finest : ndarray of int64, (2,)
        The set that each axis is unwrapped to, -1 if none.
    length : ndarray of float32, (2,)
        Projector width and height in px.
    axis : ndarray of int64, (S,)
        Axis of each set, 0 or 1.
    set_stripes : ndarray of float32, (S,)
        Stripes of each set.
    phase_noise : ndarray of float32, (S,)
        Variance of each set's phase in turns squared, per unit of (u_I/B)².
    low_u, high_u, low_v, high_v : ndarray of float32, (P,) or (0,)
        Interval of possible positions of every pixel, as shares of the projector's length; empty for all.
    alternatives : ndarray of int64, (3,)
        Where each axis starts among the J shifts of `fpplab.phase.alternatives`.
    shifts : ndarray of float32, (J,)
        Shares of the projector's length.
    shift_turns : ndarray of float32, (J, S)
        What each shift changes the phase of each set by.
    causes : ndarray of int64, (J,)
        The set that tells most of each.
    least_separation, edge_shift : ndarray of float64, (2,)
        Of each axis, see `Alternatives`.
    order_margin : ndarray of float64, (2,)
        `edge_margin` as a share of each axis' length.
    wrong_order_max : float
        Greatest probability of a wrong order; infinite where orders stay as unwrapped.
    reference : int
        The set whose modulation is reported.
    grey : float32
        8-bit grey levels per raw unit.
    full_scale : float32
        Raw value from which on a sample is saturated.
    modulation_min, contrast_min, residual_max, disagreement_max : float32
        As in `MaskRules`, in 8-bit grey levels.
    edge_margin : float32
        How far beyond the projector's edge a coordinate may lie besides its noise, in px.
    noise_constant, noise_per_level : float32
        Variance of a grey level, `noise_constant + noise_per_level * level`, in 8-bit grey levels squared.
    step : float32
        Smallest difference of two levels, in 8-bit grey levels.
    rounding_repeats : bool
        Whether noise is so small at some level that rounding repeats.
    images : ndarray of float32, (S,)
        Number of images of each set.
    error_constant, error_harmonic, error_rising : ndarray of float32, (S,)
        Mean square phase error that is common to the pixels of a phase, `constant + rising (A/B)²` of offset
        and modulation, where the variance of the phase for u_I = B is one; `error_harmonic` is the part of
        the constant that is the response's. NaN where nothing tells it.
    harmonics : ndarray of float32, (S, K)
        Harmonics of the response from the second on, as shares of the fringe.
    shift : ndarray of float32, (F, 2)
        Cosine and sine of every frame's phase shift; both 0 for padding.
    """

    addresses: NDArray[np.uintp]
    weights: NDArray[np.float32]
    first: NDArray[np.int64]
    origin: NDArray[np.float32]
    coefficients: NDArray[np.float32]
    stripes: NDArray[np.float32]
    trust: NDArray[np.float32]
    wavelengths: NDArray[np.int64]
    finest: NDArray[np.int64]
    length: NDArray[np.float32]
    axis: NDArray[np.int64]
    set_stripes: NDArray[np.float32]
    phase_noise: NDArray[np.float32]
    low_u: NDArray[np.float32]
    high_u: NDArray[np.float32]
    low_v: NDArray[np.float32]
    high_v: NDArray[np.float32]
    alternatives: NDArray[np.int64]
    shifts: NDArray[np.float32]
    shift_turns: NDArray[np.float32]
    causes: NDArray[np.int64]
    least_separation: NDArray[np.float64]
    edge_shift: NDArray[np.float64]
    order_margin: NDArray[np.float64]
    wrong_order_max: float
    reference: int
    grey: np.float32
    full_scale: np.float32
    modulation_min: np.float32
    contrast_min: np.float32
    residual_max: np.float32
    disagreement_max: np.float32
    edge_margin: np.float32
    noise_constant: np.float32
    noise_per_level: np.float32
    step: np.float32
    rounding_repeats: bool
    images: NDArray[np.float32]
    error_constant: NDArray[np.float32]
    error_harmonic: NDArray[np.float32]
    error_rising: NDArray[np.float32]
    harmonics: NDArray[np.float32]
    shift: NDArray[np.float32]


class Maps(NamedTuple):
    """Flat float32 maps of the camera's P pixels that the compiled decoder fills.

    An empty map of `u`, `v`, `doubt_u` or `doubt_v` is left out.

    Attributes
    ----------
    u, v : ndarray of float32, (P,)
        Projector coordinates in px, NaN where the pixel is not measured.
    modulation : ndarray of float32, (P,)
        Fringe amplitude B of the reference set, in 8-bit grey levels.
    sigma : ndarray of float32, (P,)
        Standard uncertainty of the coordinate of the first coded axis by noise, in px.
    phase_error : ndarray of float32, (P,)
        The same by errors that are common to the pixels of a phase.
    disagreement : ndarray of float32, (P,)
        Disagreement of the fringe sets: the root of χ² per degree of freedom.
    doubt_u, doubt_v : ndarray of float32, (P,)
        Greatest disagreement of the chosen hypothesis along each axis, in periods.
    cause : ndarray of uint8, (P,)
        1 + the index of the set whose noise left the order too uncertain, 0 elsewhere.
    """

    u: NDArray[np.float32]
    v: NDArray[np.float32]
    modulation: NDArray[np.float32]
    sigma: NDArray[np.float32]
    phase_error: NDArray[np.float32]
    disagreement: NDArray[np.float32]
    doubt_u: NDArray[np.float32]
    doubt_v: NDArray[np.float32]
    cause: NDArray[np.uint8]
