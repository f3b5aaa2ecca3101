"""Phase error of phase shifting under a nonlinear response, and how many steps keep it small.

A response turns the sinusoid `w(φ) = (1 + cos φ)/2` into `a S(w) + b = Σ_k c_k cos kφ`. N-step phase shifting
is sensitive to the harmonics `mN + 1`, m any integer (negative ones are k = |mN + 1|: N - 1, N + 1, 2N - 1,
…), which rotate the decoded vector by

    Δφ(φ) = arg(1 + Σ_{m ≠ 0} c_|mN+1|/c_1 e^{imNφ})

(Guo, He and Zhang, Opt. Lett. 29, 2004). a and b cancel. The error repeats N times in a fringe.
"""

import math

import numpy as np

from fpplab.core.config import Document
from fpplab.core.conventions import TWO_PI, Axis, Floats, axis_length, phase_steps
from fpplab.patterns.curve import Curve
from fpplab.patterns.limits import PATTERN_LIMITS as LIMITS
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Response

_PHASES = 512
"""Phases over a period at which errors are evaluated (chosen)."""
_REACH = 8
"""Multiples of the number of steps to each side whose harmonics count (chosen)."""
_TURNS = np.exp(1j * TWO_PI * np.outer(np.arange(-_REACH, _REACH + 1), np.arange(_PHASES) / _PHASES))
"""exp(imNφ) for m from -`_REACH` on, over the error's own period of Nφ."""


def harmonics(g: float, highest: int) -> Floats:
    """Compute the Fourier coefficients of a sinusoid under a power law."""
    # `((1 + cos φ)/2)^g = c_0 + 2 Σ c_k cos kφ`.
    # returns (highest + 1,)
    # cos^2g(φ/2), whose coefficients are Γ(2g + 1)/(4^g Γ(g + k + 1) Γ(g - k + 1)).
    mean = math.exp(math.lgamma(2.0 * g + 1.0) - 2.0 * math.lgamma(g + 1.0) - g * math.log(4.0))
    k = np.arange(1, highest + 1)
    return mean * np.concatenate([[1.0], np.cumprod((g - k + 1.0) / (g + k))])


def relative_harmonics(response: Curve, correction: Curve | None = None, highest: int = 64) -> Floats:
    """Compute the harmonics of a sinusoid through a response, relative to the fringe."""
    # returns (highest + 1,)
    phase = TWO_PI * np.arange(16 * _PHASES) / (16 * _PHASES)
    sinusoid = 0.5 + 0.5 * np.cos(phase)
    light = response.shape(sinusoid if correction is None else correction.correct(sinusoid))
    spectrum = np.fft.rfft(light).real[: highest + 1]
    return np.asarray(spectrum / spectrum[1])


def harmonic_phase_error(relative: Floats, steps: int) -> float:
    """Compute the RMS phase error that harmonics cause."""
    # relative (K,)
    order = np.abs(steps * np.arange(-_REACH, _REACH + 1) + 1)
    shares = np.where(order < len(relative), relative[np.minimum(order, len(relative) - 1)], 0.0)
    return _rms(np.angle(np.einsum("m,mp->p", shares, _TURNS)))


def phase_error(g: float, steps: int) -> float:
    """Compute the RMS phase error of phase shifting under a power-law response."""
    amplitudes = harmonics(g, _REACH * steps + 1)
    return harmonic_phase_error(amplitudes / amplitudes[1], steps)


def shown_phase_error(
    response: Curve, steps: int, correction: Curve | None = None, greys: int = 256
) -> float:
    """Compute the RMS phase error of patterns as they are shown, in `greys` grey levels."""
    # What the rounding to grey levels leaves is that of one mirror; a camera pixel that averages over mirrors
    # of different phase sees less of it.
    phase = TWO_PI * (np.arange(16 * _PHASES) + 0.5) / (16 * _PHASES)
    shifts = phase_steps(steps)
    sinusoids = 0.5 + 0.5 * np.cos(phase - shifts[:, None])
    shown = sinusoids if correction is None else correction.correct(sinusoids)
    light = response.shape(np.rint(shown * (greys - 1)) / (greys - 1))
    decoded = np.exp(1j * shifts) @ light
    return _rms(np.angle(decoded * np.exp(-1j * phase)))


def least_steps(response: Curve, allowed_rad: float = LIMITS.max_phase_error_rad) -> int | None:
    """Find the fewest steps from which on the phase error is acceptable without correction."""
    relative = relative_harmonics(response, highest=_REACH * LIMITS.max_steps + 1)
    fewest = None
    for steps in range(LIMITS.max_steps, 2, -1):
        if harmonic_phase_error(relative, steps) > allowed_rad:
            break
        fewest = steps
    return fewest


def unexplained_phase_error(response: Response) -> float:
    """Compute the RMS phase error that levels may hide from a fitted curve."""
    # What the curve leaves of the levels, spread over the harmonics, is taken to rotate the fringe.
    residual = response.residual if response.misfit is None else response.misfit
    return float(2.0 * residual * np.sqrt(2.0 / response.levels) / response.a)


def _rms(error: Floats) -> float:
    return float(np.sqrt(np.mean((error - error.mean()) ** 2)))


class ResponseJudgement(Document):
    """Whether a response is good enough for a plan, by the points that its finest fringe sets give."""

    good_enough: bool
    """Whether `worst_rad` is at most `max_phase_error_rad`."""
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
    """RMS phase error in rad at the worse end of the curve's uncertainty; the judgement is by this one."""
    corrected_rad: float
    """RMS phase error in rad that pre-correction by this response leaves, rounding to 256 grey levels
    included."""
    least_steps: int | None
    """Fewest steps from which on uncorrected patterns are good enough; None above `max_steps`."""
    by_steps: dict[str, float]
    """RMS phase error in rad of uncorrected patterns for every number of steps of `reported_steps`."""
    corrected_by_steps: dict[str, float]
    """The same of patterns corrected by this response."""
    rounding_by_steps: dict[str, float]
    """What the rounding of patterns to 256 grey levels alone makes, under a straight response: the floor."""


def judge_response(response: Response, plan: Plan, size: tuple[int, int]) -> ResponseJudgement:
    """Judge whether a response is good enough for a plan."""
    # A plan that corrects its patterns is judged with that correction.
    curve = Curve(a=response.a, b=response.b, g=response.g, spline=response.spline)
    ends = _curves_within_uncertainty(response, curve)
    hidden = LIMITS.coverage * unexplained_phase_error(response)

    def px(axis: Axis, stripes: float, rad: float) -> float:
        return rad / TWO_PI * axis_length(size, axis) / stripes

    def table(of: Curve, correction: Curve | None = None) -> dict[str, float]:
        return {str(n): shown_phase_error(of, n, correction) for n in LIMITS.reported_steps}

    finest = [plan.fringes[plan.finest_set(axis)] for axis in plan.unwrapped_axes]
    fringe = max(
        finest, key=lambda f: px(f.axis, f.stripes, shown_phase_error(curve, f.images, plan.response))
    )
    rad = shown_phase_error(curve, fringe.images, plan.response)
    worst = max(shown_phase_error(end, fringe.images, plan.response) for end in ends)
    left_for_harmonics = math.sqrt(max(LIMITS.max_phase_error_rad**2 - hidden**2, 0.0))
    enough = max(least_steps(end, left_for_harmonics) or LIMITS.max_steps + 1 for end in ends)
    corrected = max(shown_phase_error(end, fringe.images, curve) for end in ends)
    worst, corrected = float(np.hypot(worst, hidden)), float(np.hypot(corrected, hidden))
    judgement = ResponseJudgement(
        good_enough=worst <= LIMITS.max_phase_error_rad,
        sentence="",
        axis=fringe.axis,
        stripes=fringe.stripes,
        steps=fringe.images,
        corrected_patterns=plan.response is not None,
        phase_rad=rad,
        phase_px=px(fringe.axis, fringe.stripes, rad),
        worst_rad=worst,
        corrected_rad=corrected,
        least_steps=enough if enough <= LIMITS.max_steps else None,
        by_steps=table(curve),
        corrected_by_steps=table(curve, curve),
        rounding_by_steps=table(Curve(a=1.0, b=0.0, g=1.0)),
    )
    return judgement.model_copy(update={"sentence": _sentence(judgement)})


def _curves_within_uncertainty(response: Response, curve: Curve) -> tuple[Curve, ...]:
    """The curve, and for a power law those at both ends of its exponent's uncertainty."""
    if curve.spline:
        return (curve,)
    reach = min(LIMITS.coverage * response.sigma[2], 0.9 * response.g)
    ends = (response.g - reach, response.g, response.g + reach)
    return tuple(curve.model_copy(update={"g": g}) for g in ends)


def _sentence(judgement: ResponseJudgement) -> str:
    what = "corrected patterns" if judgement.corrected_patterns else "patterns as they are"
    says = (
        f"{judgement.steps} steps of {judgement.stripes:g} stripes, {what}: RMS phase error "
        f"{judgement.phase_rad:.2g} "
        f"rad, {judgement.phase_px:.2g} projector px (at most {judgement.worst_rad:.2g} rad within its "
        "uncertainty)"
    )
    if judgement.good_enough:
        return f"{says}: good enough, at most {LIMITS.max_phase_error_rad:g} rad are allowed"
    ways = []
    if judgement.corrected_rad <= LIMITS.max_phase_error_rad:
        ways.append(
            "pre-correct the patterns ('response' in the plan), which leaves "
            f"{judgement.corrected_rad:.2g} rad"
        )
    if judgement.least_steps:
        ways.append(f"take {judgement.least_steps} steps or more without correction")
    ways = ways or ["measure the response again with more levels and light"]
    allowed = LIMITS.max_phase_error_rad
    return f"{says}: not good enough, at most {allowed:g} rad are allowed; {', or '.join(ways)}"
