"""What a response does to the phase of fringes, and whether that matters for the steps planned.

A response bends the sinusoid `w(φ) = (1 + cos φ)/2` to `a w^g + b = Σ_k c_k cos kφ`. N steps see of it the
harmonics `mN + 1`, m any integer (negative ones are k = |mN + 1|: N - 1, N + 1, 2N - 1, …), which turn
the decoded vector by

    Δφ(φ) = arg(1 + Σ_{m ≠ 0} c_|mN+1|/c_1 e^{imNφ})

(Guo, He and Zhang, Opt. Lett. 29, 2004). a and b fall out. The error repeats N times in a fringe.
"""

from __future__ import annotations

import numpy as np

from fpplab.core.config import Document
from fpplab.core.conventions import TWO_PI, Axis, Floats, axis_length, phase_steps
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Response

ALLOWED_RAD = 0.01
"""RMS phase error that is good enough: about the noise of one pixel of twelve 8-bit frames, 0.02 px of
a projector of 912 columns at 64 stripes."""
MOST_STEPS = 30
COVERAGE = 2.0
"""A fit is judged at the worse end of g plus or minus so many of its standard uncertainties."""
TABLE = (3, 4, 5, 6, 8, 12)
"""Steps whose phase errors are always told."""

_SAMPLES = 1 << 14
_PHASES = 512


def harmonics(g: float, highest: int) -> Floats:
    """`c_0 … c_highest` of `((1 + cos φ)/2)^g = c_0 + 2 Σ c_k cos kφ`, (highest + 1,)."""
    light = (0.5 + 0.5 * np.cos(TWO_PI * np.arange(_SAMPLES) / _SAMPLES)) ** g
    return np.asarray(np.fft.rfft(light).real[: highest + 1] / _SAMPLES)


def phase_error(g: float, steps: int) -> float:
    """RMS phase error in rad of `steps` steps under the exponent g."""
    reach = max(1, min(8, 512 // steps))
    amplitudes = harmonics(g, reach * steps + 1)
    turned = np.ones(_PHASES, np.complex128)
    phase = TWO_PI * np.arange(_PHASES) / _PHASES  # N φ: the error's own period
    for m in (*range(-reach, 0), *range(1, reach + 1)):
        turned += amplitudes[abs(m * steps + 1)] / amplitudes[1] * np.exp(1j * m * phase)
    return _rms(np.angle(turned))


def corrected_phase_error(g: float, steps: int, correction: float, greys: int = 256) -> float:
    """RMS phase error in rad that is left when patterns were corrected for the exponent `correction`.

    What the rounding to `greys` grey levels leaves is of one mirror; a camera pixel that averages over
    mirrors of different phase sees less of it.
    """
    phase = TWO_PI * (np.arange(16 * _PHASES) + 0.5) / (16 * _PHASES)
    shifts = phase_steps(steps)
    shown = (0.5 + 0.5 * np.cos(phase - shifts[:, None])) ** (1.0 / correction)
    light = (np.rint(shown * (greys - 1)) / (greys - 1)) ** g
    decoded = np.exp(1j * shifts) @ light
    return _rms(np.angle(decoded * np.exp(-1j * phase)))


def least_steps(g: float, allowed_rad: float = ALLOWED_RAD) -> int | None:
    """The fewest steps with which the phase error is allowed, or None up to `MOST_STEPS`."""
    return next((n for n in range(3, MOST_STEPS + 1) if phase_error(g, n) <= allowed_rad), None)


def _rms(error: Floats) -> float:
    return float(np.sqrt(np.mean((error - error.mean()) ** 2)))


class ResponseJudgement(Document):
    """Whether a response is good enough for a plan: for its finest fringes, which make the points.

    axis, stripes, steps: the set that suffers most. phase_rad, phase_px: its RMS phase error, in rad and
    in projector px, patterns as the plan has them; worst_rad: at the worse end of g's uncertainty, by which
    is judged. corrected_rad: what pre-correction by this response leaves, rounding to 256 greys
    included. least_steps: with which uncorrected patterns would do. by_steps: `TABLE`, uncorrected.
    """

    good_enough: bool
    sentence: str
    axis: Axis
    stripes: float
    steps: int
    corrected_patterns: bool
    phase_rad: float
    phase_px: float
    worst_rad: float
    corrected_rad: float
    least_steps: int | None
    by_steps: dict[str, float]


def judge_response(response: Response, plan: Plan, size: tuple[int, int]) -> ResponseJudgement:
    """Judge a response for a plan on a projector of `size` (width, height).

    A plan that corrects its patterns is judged with that correction.
    """
    ends = _ends(response)

    def error(g: float, steps: int) -> float:
        return corrected_phase_error(g, steps, plan.response.g) if plan.response else phase_error(g, steps)

    def px(axis: Axis, stripes: float, rad: float) -> float:
        return rad / TWO_PI * axis_length(size, axis) / stripes

    finest = [plan.fringes[plan.sets_along(axis)[-1]] for axis in plan.axes]
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
