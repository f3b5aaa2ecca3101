"""The line that is told of each pose."""

from __future__ import annotations

from fpplab.setup.guide.attempts import PoseAttempt, in_um


def accepted_words(number: int, attempt: PoseAttempt, until_mm: float | None) -> str:
    """Tell of a pose that counts."""
    parts = [f"pose {number}: {attempt.points} points"]
    if attempt.rms_px:
        parts.append(_residuals(attempt))
    now, wanted = in_um(attempt.form_mm), in_um(until_mm)
    if now is None:
        parts.append("uncertainty not known yet")
    else:
        parts.append(f"uncertainty of form {now:.3g} µm" + (f" -> {wanted:.3g} µm" if wanted else ""))
    parts += [f"as in the pose before: {one.sentence}" for one in attempt.findings[:1]]
    return "; ".join(parts)


def rejected_words(number: int, attempt: PoseAttempt) -> str:
    """Tell of a pose that does not count."""
    worst, *others = attempt.findings
    more = f" (and {others[0].sentence})" if others else ""
    return f"pose {number} rejected: {worst.sentence}{more}; {worst.remedy}"


def _residuals(attempt: PoseAttempt) -> str:
    told = []
    for device in ("camera", "projector"):
        errors = getattr(attempt.fit, device) if attempt.fit else None
        expected = f" ({errors.predicted_px:.3f} predicted)" if errors else ""
        told.append(f"{device} {attempt.rms_px[device]:.3f} px{expected}")
    return ", ".join(told)
