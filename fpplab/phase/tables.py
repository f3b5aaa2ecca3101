"""What the compiled decoder reads and writes, as tuples of arrays."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Recipe(NamedTuple):
    """Everything that the compiled decoder needs to know about frames, plan, rules and noise.

    F is the padded number of frames, S of fringe sets, R of synthetic wavelengths over both axes.
    """

    addresses: NDArray[np.uintp]  # address of every frame's first pixel
    weights: NDArray[np.float32]  # weights of every frame for sine
    first: NDArray[np.int64]  # where each set starts among the F frames
    origin: NDArray[np.float32]  # phase origin of each set, in turns
    coefficients: NDArray[np.float32]  # integer combination of phases of each synthetic wavelength
    stripes: NDArray[np.float32]  # stripes of each synthetic wavelength
    trust: NDArray[np.float32]  # weight of each wavelength's squared disagreement with the one before
    wavelengths: NDArray[np.int64]  # where each axis starts among the R wavelengths
    finest: NDArray[np.int64]  # the set that each axis is unwrapped to, -1 if none
    length: NDArray[np.float32]  # projector width and height in px
    axis: NDArray[np.int64]  # axis of each set, 0 or 1
    set_stripes: NDArray[np.float32]  # stripes of each set
    phase_noise: NDArray[np.float32]  # variance of each set's phase in turns squared, per unit of (u_I/B)²
    low_u: NDArray[np.float32]  # interval of possible positions of every pixel
    high_u: NDArray[np.float32]  # interval of possible positions of every pixel
    low_v: NDArray[np.float32]  # interval of possible positions of every pixel
    high_v: NDArray[np.float32]  # interval of possible positions of every pixel
    alternatives: NDArray[np.int64]  # (3,)
    shifts: NDArray[np.float32]  # shares of the projector's length
    shift_turns: NDArray[np.float32]  # what each shift changes the phase of each set by
    causes: NDArray[np.int64]  # the set that tells most of each
    least_separation: NDArray[np.float64]  # of each axis, see `Alternatives`
    edge_shift: NDArray[np.float64]  # of each axis, see `Alternatives`
    counted_share: NDArray[np.float64]  # of each axis' variance by common errors, for orders
    order_margin: NDArray[np.float64]  # `edge_margin` as a share of each axis' length
    wrong_order_max: float  # greatest probability of a wrong order; infinite where orders stay as unwrapped
    reference: int  # the set whose modulation is reported
    grey: np.float32  # 8-bit grey levels per raw unit
    full_scale: np.float32  # raw value from which on a sample is saturated
    modulation_min: np.float32  # as in `MaskRules`, in 8-bit grey levels
    contrast_min: np.float32  # as in `MaskRules`, in 8-bit grey levels
    misfit_max: NDArray[np.float32]  # mean square misfit of each set as a share of B², harmonics included
    disagreement_max: np.float32  # as in `MaskRules`, in 8-bit grey levels
    edge_margin: np.float32  # how far beyond the projector's edge a coordinate may lie besides its noise
    noise_constant: np.float32  # variance of a grey level
    noise_per_level: np.float32  # variance of a grey level
    step: np.float32  # smallest difference of two levels, in 8-bit grey levels
    rounding_repeats: bool  # whether noise is so small at some level that rounding repeats
    misfit: NDArray[np.float32]  # (S, 3) see `misfit_limits`
    images: NDArray[np.float32]  # number of images of each set
    error_constant: NDArray[np.float32]  # mean square phase error that is common to the pixels of a phase
    error_harmonic: NDArray[np.float32]  # mean square phase error that is common to the pixels of a phase
    error_rising: NDArray[np.float32]  # mean square phase error that is common to the pixels of a phase
    harmonics: NDArray[np.float32]  # harmonics of the response from the second on, as shares of the fringe
    shift: NDArray[np.float32]  # cosine and sine of every frame's phase shift; both 0 for padding


class Maps(NamedTuple):
    """Flat float32 maps of the camera's P pixels that the compiled decoder fills.

    An empty map of `u` or `v` is left out.
    """

    u: NDArray[np.float32]  # projector coordinates in px, NaN where the pixel is not measured
    v: NDArray[np.float32]  # projector coordinates in px, NaN where the pixel is not measured
    modulation: NDArray[np.float32]  # fringe amplitude B of the reference set, in 8-bit grey levels
    sigma: NDArray[np.float32]  # standard uncertainty of the coordinate of the first coded axis by noise
    phase_error: NDArray[np.float32]  # the same by errors that are common to the pixels of a phase
    disagreement: NDArray[np.float32]  # disagreement of the fringe sets: the root of χ² per degree of freedom
    cause: NDArray[np.uint8]  # as `Decoded.uncertain_order`; UNEXPLAINED where noise explains no order
