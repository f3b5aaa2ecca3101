"""Which finding comes first: causes before what they bring about, and then by their excess."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from fpplab.diagnosis.causes.stale_calibration import STALE_CALIBRATION, USELESS_EXCESS
from fpplab.diagnosis.finding import FaultCause, Finding

MAX_SIDE_EFFECT = 0.9
"""Excess of a side effect beside that of its cause, at most. Chosen: it ranks behind the cause."""


def ranked(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Rank findings, the one to see to first at the front."""
    seen = _with_rig_first(list(findings))
    weighed = [replace(one, excess=_weight(one, seen), behind=_source(one, seen)) for one in seen]
    return tuple(sorted(weighed, key=lambda one: -one.excess))


def _with_rig_first(findings: list[Finding]) -> list[Finding]:
    """A calibration that is not the rig's comes first where nothing else puts points off their lines."""
    if any(STALE_CALIBRATION.key in one.cause.side_effects for one in findings):
        return findings
    most = max((one.excess for one in findings), default=0.0)
    return [
        replace(one, excess=max(one.excess, 1.1 * most)) if one.cause == STALE_CALIBRATION else one
        for one in findings
    ]


def _weight(finding: Finding, findings: list[Finding]) -> float:
    """Excess of a finding, below those of all that may have brought it about."""
    rest = [one for one in findings if one is not finding]
    lowest = min((_weight(one, rest) for one in _causes(finding, findings)), default=float("inf"))
    return min(finding.excess, MAX_SIDE_EFFECT * lowest)


def _source(finding: Finding, findings: list[Finding]) -> FaultCause | None:
    """The worst of the causes that may have brought a finding about."""
    causes = _causes(finding, findings)
    return max(causes, key=lambda one: one.excess).cause if causes else finding.behind


def _causes(finding: Finding, findings: list[Finding]) -> list[Finding]:
    """Which of these may have brought a finding about."""
    if finding.cause == STALE_CALIBRATION and finding.excess >= USELESS_EXCESS:
        return []
    return [one for one in findings if one is not finding and finding.cause.key in _effects(one, findings)]


def _effects(finding: Finding, findings: list[Finding]) -> set[str]:
    """What a finding may have brought about, among these."""
    effects = set(finding.cause.side_effects)
    excess = {one.cause.key: one.excess for one in findings}
    for first in {one.cause for one in findings}:
        for second, ratio in first.outweighs_from.items():
            if second not in excess:
                continue
            is_first = excess[first.key] >= ratio * excess[second]
            cause, effect = (first.key, second) if is_first else (second, first.key)
            if finding.cause.key == cause:
                effects.add(effect)
    return effects
