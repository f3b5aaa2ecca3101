"""Phase error of phase shifting under a nonlinear (gamma) response, and how many steps keep it small.

A response turns the sinusoid `w(φ) = (1 + cos φ)/2` into `a w^g + b = Σ_k c_k cos kφ`. N-step phase shifting
is sensitive to the harmonics `mN + 1`, m any integer (negative ones are k = |mN + 1|: N - 1, N + 1, 2N - 1,
…), which rotate the decoded vector by

    Δφ(φ) = arg(1 + Σ_{m ≠ 0} c_|mN+1|/c_1 e^{imNφ})

(Guo, He and Zhang, Opt. Lett. 29, 2004). a and b cancel. The error repeats N times in a fringe.
"""

from __future__ import annotations

import math

import numpy as np

from fpplab.core.config import Document
from fpplab.core.conventions import TWO_PI, Axis, Floats, axis_length, phase_steps
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Response

ALLOWED_RAD = 0.01
"""Greatest acceptable RMS phase error in rad: about the noise of one pixel of twelve 8-bit frames, 0.02 px of
a projector of 912 columns at 64 stripes.
"""
MOST_STEPS = 30
"""Greatest number of steps that `least_steps` tries."""
COVERAGE = 2.0
"""Coverage factor: a fit is judged at the worse end of g plus or minus so many of its standard
uncertainties."""
TABLE = (3, 4, 5, 6, 8, 12)
"""Numbers of steps whose phase errors are always reported."""

_PHASES = 512
_REACH = 8
_TURNS = np.exp(1j * TWO_PI * np.outer(np.arange(-_REACH, _REACH + 1), np.arange(_PHASES) / _PHASES))
"""exp(imNφ) for m from -`_REACH` on, over the error's own period of Nφ."""


def harmonics(g: float, highest: int) -> Floats:
    """Compute the Fourier coefficients of a sinusoid under a power law.

    `((1 + cos φ)/2)^g = c_0 + 2 Σ c_k cos kφ`.

    Parameters
    ----------
    g : float
        Exponent of the response.
    highest : int
        Highest harmonic.

    Returns
    -------
    ndarray of float64, (highest + 1,)
        `c_0 … c_highest`.
    """
    # cos^2g(φ/2), whose coefficients are Γ(2g + 1)/(4^g Γ(g + k + 1) Γ(g - k + 1)).
    mean = math.exp(math.lgamma(2.0 * g + 1.0) - 2.0 * math.lgamma(g + 1.0) - g * math.log(4.0))
    k = np.arange(1, highest + 1)
    return mean * np.concatenate([[1.0], np.cumprod((g - k + 1.0) / (g + k))])


def phase_error(g: float, steps: int) -> float:
    """Compute the RMS phase error of phase shifting under a power-law response.

    Parameters
    ----------
    g : float
        Exponent of the response.
    steps : int
        Number N of equally spaced steps.

    Returns
    -------
    float
        RMS phase error in rad.

    References
    ----------
    Guo, He and Zhang, Opt. Lett. 29, 2004
    """
    order = np.abs(steps * np.arange(-_REACH, _REACH + 1) + 1)
    amplitudes = harmonics(g, int(order.max()))
    turned = np.einsum("m,mp->p", amplitudes[order] / amplitudes[1], _TURNS)
    return _rms(np.angle(turned))


def corrected_phase_error(g: float, steps: int, correction: float, greys: int = 256) -> float:
    """Compute the RMS phase error that remains after the patterns were pre-corrected.

    What the rounding to `greys` grey levels leaves is that of one mirror; a camera pixel that averages over
    mirrors of different phase sees less of it.

    Parameters
    ----------
    g : float
        Exponent of the response.
    steps : int
        Number of equally spaced steps.
    correction : float
        Exponent that the patterns were corrected for.
    greys : int
        Number of grey levels of the projector.

    Returns
    -------
    float
        RMS phase error in rad.
    """
    phase = TWO_PI * (np.arange(16 * _PHASES) + 0.5) / (16 * _PHASES)
    shifts = phase_steps(steps)
    shown = (0.5 + 0.5 * np.cos(phase - shifts[:, None])) ** (1.0 / correction)
    light = (np.rint(shown * (greys - 1)) / (greys - 1)) ** g
    decoded = np.exp(1j * shifts) @ light
    return _rms(np.angle(decoded * np.exp(-1j * phase)))


def least_steps(g: float, allowed_rad: float = ALLOWED_RAD) -> int | None:
    """Find the fewest steps whose phase error is acceptable without correction.

    Parameters
    ----------
    g : float
        Exponent of the response.
    allowed_rad : float
        Greatest acceptable RMS phase error in rad.

    Returns
    -------
    int or None
        From 3 to `MOST_STEPS`; None where even `MOST_STEPS` are too few.
    """
    return next((n for n in range(3, MOST_STEPS + 1) if phase_error(g, n) <= allowed_rad), None)


def _rms(error: Floats) -> float:
    return float(np.sqrt(np.mean((error - error.mean()) ** 2)))


class ResponseJudgement(Document):
    """Whether a response is good enough for a plan.

    Judged by the plan's finest fringe sets, from which the points are computed.
    """

    good_enough: bool
    """Whether `worst_rad` is at most `ALLOWED_RAD`."""
    sentence: str
    """The judgement in one sentence, with advice where it is not good enough."""
    axis: Axis
    """Axis of the fringe set with the greatest error in projector px."""
    stripes: float
    """Stripes of that set."""
    steps: int
    """Phase-shifting steps of that set."""
    corrected_patterns: bool
    """Whether the plan corrects its patterns for a response."""
    phase_rad: float
    """RMS phase error of that set in rad, with the patterns as the plan has them."""
    phase_px: float
    """The same in projector px."""
    worst_rad: float
    """RMS phase error in rad at the worse end of g's uncertainty; the judgement is by this one."""
    corrected_rad: float
    """RMS phase error in rad that pre-correction by this response leaves, rounding to 256 grey levels
    included."""
    least_steps: int | None
    """Fewest steps with which uncorrected patterns are good enough; None above `MOST_STEPS`."""
    by_steps: dict[str, float]
    """RMS phase error in rad of uncorrected patterns for every number of steps of `TABLE`."""


def judge_response(response: Response, plan: Plan, size: tuple[int, int]) -> ResponseJudgement:
    """Judge whether a response is good enough for a plan.

    A plan that corrects its patterns is judged with that correction.

    Parameters
    ----------
    response : Response
        The measured response, with the uncertainty of its exponent.
    plan : Plan
        The plan.
    size : tuple of int
        Width and height of the projector in px.

    Returns
    -------
    ResponseJudgement
        The verdict with its figures.
    """
    ends = _ends(response)

    def error(g: float, steps: int) -> float:
        return corrected_phase_error(g, steps, plan.response.g) if plan.response else phase_error(g, steps)

    def px(axis: Axis, stripes: float, rad: float) -> float:
        return rad / TWO_PI * axis_length(size, axis) / stripes

    finest = [plan.fringes[plan.finest_set(axis)] for axis in plan.axes]
    fringe = max(finest, key=lambda f: px(f.axis, f.stripes, error(response.g, f.images)))
    rad = error(response.g, fringe.images)
    worst = max(error(g, fringe.images) for g in ends)
    enough = max(least_steps(g) or MOST_STEPS + 1 for g in ends)
    found = ResponseJudgement(
        good_enough=worst <= ALLOWED_RAD,
        sentence="",
        axis=fringe.axis,
        stripes=fringe.stripes,
        steps=fringe.images,
        corrected_patterns=plan.response is not None,
        phase_rad=rad,
        phase_px=px(fringe.axis, fringe.stripes, rad),
        worst_rad=worst,
        corrected_rad=max(corrected_phase_error(g, fringe.images, response.g) for g in ends),
        least_steps=enough if enough <= MOST_STEPS else None,
        by_steps={str(n): phase_error(response.g, n) for n in TABLE},
    )
    return found.model_copy(update={"sentence": _sentence(found)})


def _ends(response: Response) -> tuple[float, ...]:
    reach = min(COVERAGE * response.sigma[2], 0.9 * response.g)
    return response.g - reach, response.g, response.g + reach


def _sentence(found: ResponseJudgement) -> str:
    what = "corrected patterns" if found.corrected_patterns else "patterns as they are"
    says = (
        f"{found.steps} steps of {found.stripes:g} stripes, {what}: RMS phase error {found.phase_rad:.2g} "
        f"rad, {found.phase_px:.2g} projector px (at most {found.worst_rad:.2g} rad within g's uncertainty)"
    )
    if found.good_enough:
        return f"{says}: good enough, at most {ALLOWED_RAD:g} rad are allowed"
    ways = []
    if found.corrected_rad <= ALLOWED_RAD:
        ways.append(
            f"pre-correct the patterns ('response' in the plan), which leaves {found.corrected_rad:.2g} rad"
        )
    if found.least_steps:
        ways.append(f"take {found.least_steps} steps or more without correction")
    ways = ways or ["measure the response again with more levels and light"]
    return f"{says}: not good enough, at most {ALLOWED_RAD:g} rad are allowed; {', or '.join(ways)}"
