"""Whether an acceptance test shows a system that may be used, and what its errors come from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fpplab.comparison.acceptance import QUANTITIES, Acceptance, MeasuredFeature, shared_variance
from fpplab.diagnosis.causes.of_acceptance import (
    FEW_POSITIONS,
    FORM,
    NO_LIMITS,
    NOISE,
    SCALE,
    SPHERE_SIZE,
    UNEVEN_LENGTHS,
    USELESS_ERROR,
    AcceptanceTestLimits,
)
from fpplab.diagnosis.finding import Finding
from fpplab.diagnosis.limits import USUAL_LIMITS, DiagnosisLimits
from fpplab.diagnosis.verdict import Diagnosis, diagnosis_of


def diagnose_acceptance(found: Acceptance, limits: DiagnosisLimits = USUAL_LIMITS) -> Diagnosis:
    """Judge a measuring system by its acceptance test.

    An error that is not permitted, and too few positions, make it doubtful. An error of ten times what is
    permitted, or lengths that are wrong by 1 % throughout, make it useless.
    """
    judged, own = found.judgements(), limits.of(AcceptanceTestLimits)
    findings = [*_of_form(found, own), *_of_lengths(found, own), *_of_size(found, own), *_of_positions(found)]
    unjudged = [name for name, one in judged.items() if one.passed is None]
    unknown = [f"{name}: no maximum permissible error is stated" for name in unjudged]
    unknown += [f"{name}: was not measured" for name in QUANTITIES if name not in judged]
    if len(unjudged) == len(judged):
        findings.append(Finding(NO_LIMITS, f"none is stated for {', '.join(judged)}", 1.0))
    passed = [name for name in judged if name not in unjudged]
    good = f"{', '.join(passed)} are within what is permitted, in enough positions"
    return diagnosis_of(findings, good, unknown, {one.cause: one.cause.useless_from for one in findings})


def mean_scale(found: Acceptance) -> tuple[float, float] | None:
    """Estimate the error of scale from the spacings of a ball bar."""
    if not found.bars:
        return None
    errors = np.array([bar.spacing_mm / bar.calibrated_mm - 1.0 for bar in found.bars])
    own = 0.5 * found.standard.reference_uncertainty_um("SD") / 1e3 / found.bars[0].calibrated_mm
    scatter = float(errors.std(ddof=1) / np.sqrt(len(errors))) if len(errors) > 1 else 0.0
    return float(errors.mean()), float(np.hypot(scatter, own))


def _error_ratio(found: Acceptance, quantity: str) -> float:
    """The greatest error, with the standard's uncertainty, over what is permitted; 0 without a limit."""
    one = found.judgements().get(quantity)
    if one is None or one.mpe_um is None:
        return 0.0
    return (abs(one.worst_um) + one.reference_uncertainty_um) / one.mpe_um


def _described(found: Acceptance, quantity: str) -> str:
    one = found.judgements()[quantity]
    permitted = "" if one.mpe_um is None else f" (permitted {one.mpe_um:g})"
    return f"{quantity} is {one.worst_um:.1f} µm{permitted}"


def _of_form(found: Acceptance, limits: AcceptanceTestLimits) -> list[Finding]:
    features: dict[str, Sequence[MeasuredFeature]] = {
        "PF": [test.measured for bar in found.bars for test in bar.spheres],
        "F": [plane.measured for plane in found.planes],
    }
    findings = []
    for name, measured in features.items():
        if (excess := _error_ratio(found, name)) <= 1.0:
            continue
        worst = max(measured, key=lambda feature: feature.span_um)
        share = shared_variance(worst)
        evidence = _described(found, name)
        if share is None:
            findings.append(Finding(FORM, evidence, excess))
        else:
            cause = FORM if share > limits.min_shared_variance else NOISE
            evidence += f"; neighbouring pixels share {100 * max(share, 0.0):.0f} % of the variance"
            findings.append(Finding(cause, evidence, excess))
    return findings


def _of_lengths(found: Acceptance, limits: AcceptanceTestLimits) -> list[Finding]:
    scale = mean_scale(found)
    if scale is None:
        return []
    mean, sigma = scale
    permitted = _error_ratio(found, "SD")
    excess = permitted
    if abs(mean) >= limits.useless_scale:
        excess = max(permitted, USELESS_ERROR * abs(mean) / limits.useless_scale)
    if excess <= 1.0:
        return []
    evidence = f"lengths are wrong by {100 * mean:+.3f} % on average over {len(found.bars)} positions"
    if permitted > 1.0:
        evidence = f"{_described(found, 'SD')}; {evidence}"
    # One position cannot tell a scale from what depends on the place; the simpler one is named.
    cause = SCALE if abs(mean) > limits.min_scale_sigmas * sigma else UNEVEN_LENGTHS
    return [Finding(cause, evidence, excess)]


def _of_size(found: Acceptance, limits: AcceptanceTestLimits) -> list[Finding]:
    """Spheres of a wrong size, unless an error of scale explains it."""
    if (excess := _error_ratio(found, "PS")) <= 1.0:
        return []
    mean, _ = mean_scale(found) or (0.0, 0.0)
    sizes = [test for bar in found.bars for test in bar.spheres]
    remaining = max(abs(one.size_um - 1e3 * mean * one.calibrated_mm) for one in sizes)
    evidence = f"{_described(found, 'PS')}; {remaining:.1f} µm are left when the scale is taken out"
    if remaining > (found.standard.permitted_um("PS") or 0.0):
        return [Finding(SPHERE_SIZE, evidence, excess)]
    return [] if _of_lengths(found, limits) else [Finding(SCALE, evidence, excess)]


def _of_positions(found: Acceptance) -> list[Finding]:
    short = {n: one for n, one in found.judgements().items() if one.positions < one.least_positions}
    if not short:
        return []
    evidence = ", ".join(f"{n} in {one.positions} of {one.least_positions}" for n, one in short.items())
    # Few positions weaken a test; they are named after whatever fails in it.
    return [Finding(FEW_POSITIONS, f"measured in too few positions: {evidence}", 1.0)]
