"""Which finding comes first: causes before what they bring about, and then by their excess."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from fpplab.diagnosis.catalogue import FaultCause, Finding

_ROUGH = frozenset({FaultCause.INTERREFLECTION, FaultCause.WRONG_RESOLUTION})
"""What errors of the phase from place to place look like."""

SIDE_EFFECTS: Mapping[FaultCause, frozenset[FaultCause]] = {
    FaultCause.PROJECTOR_DARK: frozenset({FaultCause.NO_OVERLAP}),
    FaultCause.WRONG_PLAN: frozenset({FaultCause.STALE_CALIBRATION}),
    FaultCause.MISSING_COLOUR: frozenset({FaultCause.STALE_CALIBRATION}),
    FaultCause.VIBRATION: _ROUGH | {FaultCause.FLICKER, FaultCause.STALE_CALIBRATION},
    FaultCause.SATURATED: _ROUGH | {FaultCause.BANDS, FaultCause.STALE_CALIBRATION},
    FaultCause.UNDEREXPOSED: frozenset({FaultCause.BANDS}),
    FaultCause.AMBIENT: frozenset({FaultCause.BANDS}),
    FaultCause.RESPONSE: frozenset({FaultCause.WRONG_RESOLUTION, FaultCause.STALE_CALIBRATION}),
    FaultCause.HARMONICS: frozenset({FaultCause.WRONG_RESOLUTION}),
    FaultCause.BANDS: _ROUGH,
    FaultCause.FLICKER: _ROUGH | {FaultCause.STALE_CALIBRATION},
    FaultCause.CAMERA_FOCUS: frozenset({FaultCause.WRONG_RESOLUTION, FaultCause.STALE_CALIBRATION}),
    FaultCause.WRONG_RESOLUTION: frozenset({FaultCause.STALE_CALIBRATION}),
}
"""Causes, and what else the frames or points show because of each."""

MUTUAL: Mapping[tuple[FaultCause, FaultCause], float] = {
    (FaultCause.VIBRATION, FaultCause.BANDS): 0.25,
    (FaultCause.BANDS, FaultCause.FLICKER): 0.25,
    (FaultCause.BANDS, FaultCause.RESPONSE): 0.5,
    (FaultCause.BANDS, FaultCause.HARMONICS): 0.5,
    (FaultCause.INTERREFLECTION, FaultCause.HARMONICS): 1.0,
    (FaultCause.INTERREFLECTION, FaultCause.RESPONSE): 1.0,
}
"""Pairs of which each leaves something of itself in the other's figure, and the excess of the first beside
that of the second from which on the first is the cause."""

BEHIND = 0.9
"""Excess of a side effect beside that of its cause, at most."""

RUINOUS_OFFSET = 10.0
"""Excess of a calibration that is so far off that nothing else explains it."""


def ranked(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Rank findings, the one to see to first at the front."""
    seen = _with_rig_first(list(findings))
    weighed = [replace(one, excess=_weight(one, seen), behind=_source(one, seen)) for one in seen]
    return tuple(sorted(weighed, key=lambda one: -one.excess))


def _with_rig_first(findings: list[Finding]) -> list[Finding]:
    """A calibration that is not the rig's comes first where nothing else puts points off their lines."""
    stale = FaultCause.STALE_CALIBRATION
    if any(stale in SIDE_EFFECTS.get(one.cause, ()) for one in findings):
        return findings
    most = max((one.excess for one in findings), default=0.0)
    return [
        replace(one, excess=max(one.excess, 1.1 * most)) if one.cause is stale else one for one in findings
    ]


def _weight(finding: Finding, findings: list[Finding]) -> float:
    """Excess of a finding, below those of all that may have brought it about."""
    rest = [one for one in findings if one is not finding]
    least = min((_weight(one, rest) for one in _causes(finding, findings)), default=float("inf"))
    return min(finding.excess, BEHIND * least)


def _source(finding: Finding, findings: list[Finding]) -> FaultCause | None:
    """The worst of the causes that may have brought a finding about."""
    causes = _causes(finding, findings)
    return max(causes, key=lambda one: one.excess).cause if causes else finding.behind


def _causes(finding: Finding, findings: list[Finding]) -> list[Finding]:
    """Which of these may have brought a finding about."""
    if finding.cause is FaultCause.STALE_CALIBRATION and finding.excess >= RUINOUS_OFFSET:
        return []
    return [one for one in findings if one is not finding and finding.cause in _effects(one, findings)]


def _effects(finding: Finding, findings: list[Finding]) -> set[FaultCause]:
    """What a finding may have brought about, among these."""
    effects = set(SIDE_EFFECTS.get(finding.cause, ()))
    excess = {one.cause: one.excess for one in findings}
    for (one, other), share in MUTUAL.items():
        if one in excess and other in excess:
            cause, effect = (one, other) if excess[one] >= share * excess[other] else (other, one)
            effects |= {effect} if finding.cause is cause else set()
    return effects
