"""Whether an acceptance test shows a system that may be used, and what its errors come from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fpplab.acceptance import QUANTITIES, Acceptance, MeasuredFeature, shared_variance
from fpplab.diagnosis.catalogue import FaultCause, Finding
from fpplab.diagnosis.verdict import Diagnosis, diagnosis_of

SHARED = 0.5
"""Share of the variance that neighbouring pixels have in common, from which an error of form is no noise."""
SIGNIFICANT = 3.0
"""Standard uncertainties by which the mean error of the lengths must differ from zero to be one of scale."""
GROSS_SCALE = 0.01
"""Relative error of all lengths that counts like an error of ten times what is permitted."""
OF_NO_USE = 10.0
"""Error, as a multiple of the permissible one, from which on nobody should use the system."""
RUINOUS = dict.fromkeys(
    (
        FaultCause.FORM,
        FaultCause.NOISE,
        FaultCause.SCALE,
        FaultCause.UNEVEN_LENGTHS,
        FaultCause.SPHERE_SIZE,
    ),
    OF_NO_USE,
)


def diagnose_acceptance(found: Acceptance) -> Diagnosis:
    """Judge a measuring system by its acceptance test.

    An error that is not permitted, and too few positions, make it doubtful. An error of ten times what is
    permitted, or lengths that are wrong by 1 % throughout, make it useless.
    """
    judged = found.judgements()
    findings = [*_of_form(found), *_of_lengths(found), *_of_size(found), *_of_positions(found)]
    unjudged = [name for name, one in judged.items() if one.passed is None]
    unknown = [f"{name}: no maximum permissible error is stated" for name in unjudged]
    unknown += [f"{name}: was not measured" for name in QUANTITIES if name not in judged]
    if len(unjudged) == len(judged):
        findings.append(Finding(FaultCause.NO_LIMITS, f"none is stated for {', '.join(judged)}", 1.0))
    passed = [name for name in judged if name not in unjudged]
    good = f"{', '.join(passed)} are within what is permitted, in enough positions"
    return diagnosis_of(findings, good, unknown, RUINOUS)


def mean_scale(found: Acceptance) -> tuple[float, float] | None:
    """Estimate the error of scale from the spacings of a ball bar."""
    if not found.bars:
        return None
    errors = np.array([bar.spacing_mm / bar.calibrated_mm - 1.0 for bar in found.bars])
    own = 0.5 * found.standard.reference_uncertainty_um("SD") / 1e3 / found.bars[0].calibrated_mm
    scatter = float(errors.std(ddof=1) / np.sqrt(len(errors))) if len(errors) > 1 else 0.0
    return float(errors.mean()), float(np.hypot(scatter, own))


def _over(found: Acceptance, quantity: str) -> float:
    """The greatest error, with the standard's uncertainty, over what is permitted; 0 without a limit."""
    one = found.judgements().get(quantity)
    if one is None or one.mpe_um is None:
        return 0.0
    return (abs(one.worst_um) + one.reference_uncertainty_um) / one.mpe_um


def _beside(found: Acceptance, quantity: str) -> str:
    one = found.judgements()[quantity]
    permitted = "" if one.mpe_um is None else f" (permitted {one.mpe_um:g})"
    return f"{quantity} is {one.worst_um:.1f} µm{permitted}"


def _of_form(found: Acceptance) -> list[Finding]:
    features: dict[str, Sequence[MeasuredFeature]] = {
        "PF": [test.measured for bar in found.bars for test in bar.spheres],
        "F": [plane.measured for plane in found.planes],
    }
    findings = []
    for name, measured in features.items():
        if (excess := _over(found, name)) <= 1.0:
            continue
        worst = max(measured, key=lambda one: one.span_um)
        share = shared_variance(worst)
        words = _beside(found, name)
        if share is None:
            findings.append(Finding(FaultCause.FORM, words, excess))
        else:
            cause = FaultCause.FORM if share > SHARED else FaultCause.NOISE
            words += f"; neighbouring pixels share {100 * max(share, 0.0):.0f} % of the variance"
            findings.append(Finding(cause, words, excess))
    return findings


def _of_lengths(found: Acceptance) -> list[Finding]:
    scale = mean_scale(found)
    if scale is None:
        return []
    mean, sigma = scale
    permitted = _over(found, "SD")
    excess = max(permitted, OF_NO_USE * abs(mean) / GROSS_SCALE if abs(mean) >= GROSS_SCALE else 0.0)
    if excess <= 1.0:
        return []
    words = f"lengths are wrong by {100 * mean:+.3f} % on average over {len(found.bars)} positions"
    if permitted > 1.0:
        words = f"{_beside(found, 'SD')}; {words}"
    # One position cannot tell a scale from what depends on the place; the simpler one is named.
    cause = FaultCause.SCALE if abs(mean) > SIGNIFICANT * sigma else FaultCause.UNEVEN_LENGTHS
    return [Finding(cause, words, excess)]


def _of_size(found: Acceptance) -> list[Finding]:
    """Spheres of a wrong size, unless an error of scale explains it."""
    if (excess := _over(found, "PS")) <= 1.0:
        return []
    mean, _ = mean_scale(found) or (0.0, 0.0)
    sizes = [test for bar in found.bars for test in bar.spheres]
    left = max(abs(one.size_um - 1e3 * mean * one.calibrated_mm) for one in sizes)
    words = f"{_beside(found, 'PS')}; {left:.1f} µm are left when the scale is taken out"
    if left > (found.standard.permitted_um("PS") or 0.0):
        return [Finding(FaultCause.SPHERE_SIZE, words, excess)]
    return [] if _of_lengths(found) else [Finding(FaultCause.SCALE, words, excess)]


def _of_positions(found: Acceptance) -> list[Finding]:
    short = {n: one for n, one in found.judgements().items() if one.positions < one.least_positions}
    if not short:
        return []
    words = ", ".join(f"{n} in {one.positions} of {one.least_positions}" for n, one in short.items())
    # Few positions weaken a test; they are told after whatever fails in it.
    return [Finding(FaultCause.FEW_POSITIONS, f"measured in too few positions: {words}", 1.0)]
