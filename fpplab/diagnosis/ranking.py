"""Which finding comes first: causes before what they bring about, and then by their excess."""

from collections.abc import Iterable
from dataclasses import replace

from fpplab.diagnosis.causes.stale_calibration import STALE_CALIBRATION
from fpplab.diagnosis.finding import FaultCause, Finding


def rank_findings(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    ordered = _with_rig_first(list(findings))
    weighed = [
        replace(
            finding,
            excess=_excess_below_causes(finding, ordered),
            behind=_worst_possible_cause(finding, ordered),
        )
        for finding in ordered
    ]
    return tuple(sorted(weighed, key=lambda finding: -finding.excess))


def _with_rig_first(findings: list[Finding]) -> list[Finding]:
    """A calibration that is not the rig's comes first where nothing else puts points off their lines."""
    if any(STALE_CALIBRATION.key in finding.cause.side_effects for finding in findings):
        return findings
    max_excess = max((finding.excess for finding in findings), default=0.0)
    return [
        replace(finding, excess=max(finding.excess, 1.1 * max_excess))
        if finding.cause == STALE_CALIBRATION
        else finding
        for finding in findings
    ]


def _excess_below_causes(finding: Finding, findings: list[Finding]) -> float:
    """Excess of a finding, limited to nine tenths of its possible causes' so that it ranks behind them."""
    others = [other for other in findings if other is not finding]
    lowest = min(
        (_excess_below_causes(other, others) for other in _possible_causes(finding, findings)),
        default=float("inf"),
    )
    return min(finding.excess, 0.9 * lowest)


def _worst_possible_cause(finding: Finding, findings: list[Finding]) -> FaultCause | None:
    causes = _possible_causes(finding, findings)
    return max(causes, key=lambda source: source.excess).cause if causes else finding.behind


def _possible_causes(finding: Finding, findings: list[Finding]) -> list[Finding]:
    """Which of these may have caused a finding."""
    if finding.cause == STALE_CALIBRATION and finding.excess >= STALE_CALIBRATION.useless_from:
        return []
    return [
        other
        for other in findings
        if other is not finding and finding.cause.key in _possible_effects(other, findings)
    ]


def _possible_effects(finding: Finding, findings: list[Finding]) -> set[str]:
    """What a finding may have caused, among these."""
    effects = set(finding.cause.side_effects)
    excess = {other.cause.key: other.excess for other in findings}
    for first in {other.cause for other in findings}:
        for second, ratio in first.outweighs_from.items():
            if second not in excess:
                continue
            is_first = excess[first.key] >= ratio * excess[second]
            cause, effect = (first.key, second) if is_first else (second, first.key)
            if finding.cause.key == cause:
                effects.add(effect)
    return effects
