"""Whether an acceptance test shows a system that may be used, and what its errors come from."""

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


def diagnose_acceptance(acceptance: Acceptance, limits: DiagnosisLimits = USUAL_LIMITS) -> Diagnosis:
    # An error that is not permitted, and too few positions, make it doubtful. An error of ten times what is
    # permitted, or lengths that are wrong by 1 % throughout, make it useless.
    judged, test_limits = acceptance.judgements(), limits.of(AcceptanceTestLimits)
    findings = [
        *_of_form(acceptance, test_limits),
        *_of_lengths(acceptance, test_limits),
        *_of_size(acceptance, test_limits),
        *_of_positions(acceptance),
    ]
    unjudged = [name for name, judgement in judged.items() if judgement.passed is None]
    unknown = [f"{name}: no maximum permissible error is stated" for name in unjudged]
    unknown += [f"{name}: was not measured" for name in QUANTITIES if name not in judged]
    if len(unjudged) == len(judged):
        findings.append(Finding(NO_LIMITS, f"none is stated for {', '.join(judged)}", 1.0))
    passed = [name for name in judged if name not in unjudged]
    good = f"{', '.join(passed)} are within what is permitted, in enough positions"
    return diagnosis_of(
        findings, good, unknown, {finding.cause: finding.cause.useless_from for finding in findings}
    )


def mean_scale(acceptance: Acceptance) -> tuple[float, float] | None:
    """Estimate the error of scale from the spacings of a ball bar."""
    if not acceptance.bars:
        return None
    errors = np.array([bar.spacing_mm / bar.calibrated_mm - 1.0 for bar in acceptance.bars])
    reference_uncertainty = (
        0.5 * acceptance.standard.reference_uncertainty_um("SD") / 1e3 / acceptance.bars[0].calibrated_mm
    )
    scatter = float(errors.std(ddof=1) / np.sqrt(len(errors))) if len(errors) > 1 else 0.0
    return float(errors.mean()), float(np.hypot(scatter, reference_uncertainty))


def _error_ratio(acceptance: Acceptance, quantity: str) -> float:
    """The greatest error, with the standard's uncertainty, over what is permitted; 0 without a limit."""
    judgement = acceptance.judgements().get(quantity)
    if judgement is None or judgement.mpe_um is None:
        return 0.0
    return (abs(judgement.worst_um) + judgement.reference_uncertainty_um) / judgement.mpe_um


def _describe_quantity(acceptance: Acceptance, quantity: str) -> str:
    judgement = acceptance.judgements()[quantity]
    permitted = "" if judgement.mpe_um is None else f" (permitted {judgement.mpe_um:g})"
    return f"{quantity} is {judgement.worst_um:.1f} µm{permitted}"


def _of_form(acceptance: Acceptance, limits: AcceptanceTestLimits) -> list[Finding]:
    features: dict[str, Sequence[MeasuredFeature]] = {
        "PF": [test.measured for bar in acceptance.bars for test in bar.spheres],
        "F": [plane.measured for plane in acceptance.planes],
    }
    findings = []
    for name, measured in features.items():
        if (excess := _error_ratio(acceptance, name)) <= 1.0:
            continue
        worst = max(measured, key=lambda feature: feature.span_um)
        share = shared_variance(worst)
        evidence = _describe_quantity(acceptance, name)
        if share is None:
            findings.append(Finding(FORM, evidence, excess))
        else:
            cause = FORM if share > limits.min_shared_variance else NOISE
            evidence += f"; neighbouring pixels share {100 * max(share, 0.0):.0f} % of the variance"
            findings.append(Finding(cause, evidence, excess))
    return findings


def _of_lengths(acceptance: Acceptance, limits: AcceptanceTestLimits) -> list[Finding]:
    scale = mean_scale(acceptance)
    if scale is None:
        return []
    mean, sigma = scale
    permitted = _error_ratio(acceptance, "SD")
    excess = permitted
    if abs(mean) >= limits.useless_scale:
        excess = max(permitted, USELESS_ERROR * abs(mean) / limits.useless_scale)
    if excess <= 1.0:
        return []
    evidence = f"lengths are wrong by {100 * mean:+.3f} % on average over {len(acceptance.bars)} positions"
    if permitted > 1.0:
        evidence = f"{_describe_quantity(acceptance, 'SD')}; {evidence}"
    # One position cannot distinguish a scale from what depends on the place; the simpler one is named.
    cause = SCALE if abs(mean) > limits.min_scale_sigmas * sigma else UNEVEN_LENGTHS
    return [Finding(cause, evidence, excess)]


def _of_size(acceptance: Acceptance, limits: AcceptanceTestLimits) -> list[Finding]:
    """Spheres of a wrong size, unless an error of scale explains it."""
    if (excess := _error_ratio(acceptance, "PS")) <= 1.0:
        return []
    mean, _ = mean_scale(acceptance) or (0.0, 0.0)
    sizes = [test for bar in acceptance.bars for test in bar.spheres]
    remaining = max(abs(sphere.size_um - 1e3 * mean * sphere.calibrated_mm) for sphere in sizes)
    evidence = (
        f"{_describe_quantity(acceptance, 'PS')}; {remaining:.1f} µm are left when the scale is taken out"
    )
    if remaining > (acceptance.standard.permitted_um("PS") or 0.0):
        return [Finding(SPHERE_SIZE, evidence, excess)]
    return [] if _of_lengths(acceptance, limits) else [Finding(SCALE, evidence, excess)]


def _of_positions(acceptance: Acceptance) -> list[Finding]:
    short = {
        n: judgement
        for n, judgement in acceptance.judgements().items()
        if judgement.positions < judgement.min_positions
    }
    if not short:
        return []
    evidence = ", ".join(
        f"{n} in {judgement.positions} of {judgement.min_positions}" for n, judgement in short.items()
    )
    # Few positions weaken a test; they are named after whatever fails in it.
    return [Finding(FEW_POSITIONS, f"measured in too few positions: {evidence}", 1.0)]
