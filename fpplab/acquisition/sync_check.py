"""A marker: uniform greys in an order that no slip survives, and what it tells about a bench.

What a camera sees of uniform greys must rise with them, whatever the response, the scene and the exposure. In
the order shown neighbours differ by a third of all levels or more, so that a frame that shows another's grey
stands out, and the faults of `synchronisation` fit the levels that were seen or do not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from fpplab.acquisition.acquire import expose
from fpplab.acquisition.synchronisation import Cause, SyncFault, faults, remedy
from fpplab.core.conventions import Floats, full_scale
from fpplab.core.errors import DeviceError, DeviceTimeoutError
from fpplab.core.progress import Progress
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import uniform_patterns
from fpplab.patterns.plan import Plan

ORDER = (7, 0, 5, 9, 4, 8, 3, 10, 1, 6, 2, 11)
"""Levels by their rank, 0 the darkest. Twelve fill the places of four 24-bit images. Of orders whose
neighbours differ by four steps or more this one, of many tried, leaves the greatest departure between any two
slips: 6 % of the range, 2 % at a gamma of 2.2. Both its ends are brighter than the darkness around it.
"""
LEAST_RISE = 0.05
"""Share of full scale by which white must be brighter than black."""
SATURATED = 0.01
"""Share of the lit pixels at full scale beyond which the exposure is too long."""
FOLLOWS = 0.015
"""RMS of what the levels may depart from a rising curve, as a share of their range."""
SETTLE_S = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Settling times that are tried, in s."""
PIXELS = 20_000


@dataclass(frozen=True)
class Finding:
    """What is wrong with a bench, how that shows, and what to do."""

    cause: str
    evidence: str
    remedy: str


@dataclass(frozen=True, eq=False)
class Seen:
    """One run of the marker. how: "stepped" or "triggered".

    levels: (K,) means of the lit pixels as shares of full scale, in the order shown; NaN where no frame came.
    saturated: share of these pixels at full scale in any frame.
    """

    how: str
    levels: Floats
    saturated: float

    @property
    def rise(self) -> float:
        """From the darkest to the brightest."""
        return float(np.nanmax(self.levels) - np.nanmin(self.levels))


@dataclass(frozen=True, eq=False)
class Checked:
    """What `check_rig` found.

    shown: (K,) greys of 255 in the order shown. settle_s: what a stepped plan needs, where the plan's
    was too short and another served.
    """

    shown: NDArray[np.int64]
    runs: tuple[Seen, ...]
    findings: tuple[Finding, ...]
    settle_s: float | None = None

    def summary(self) -> dict[str, Any]:
        """The keys of `fpplab check --json`."""
        return {
            "ok": not self.findings,
            "findings": [asdict(finding) for finding in self.findings],
            "settle_s": self.settle_s,
            "shown": self.shown.tolist(),
            "seen": {run.how: [_or_none(level) for level in run.levels.tolist()] for run in self.runs},
        }


def marker() -> NDArray[np.int64]:
    """Greys of 255 in the order shown, (12,)."""
    return np.asarray(np.rint(np.array(ORDER) * 255 / (len(ORDER) - 1)), np.int64)


def slips(shown: Sequence[int] | NDArray[np.int64], levels: Floats) -> tuple[SyncFault, ...] | None:
    """The faults under which the levels seen follow the greys: () when in step, None when nothing does.

    levels: (K,), NaN where no frame came. Of faults that fit, those that explain the most frames. Greys do
    not swap, for nothing but a trigger has slipped.
    """
    greys, in_step = np.asarray(shown), list(range(len(shown)))
    if _departure(greys, levels, in_step) <= FOLLOWS:
        return ()
    rows = {f: f.shown(len(greys)) for f in faults(len(greys)) if f.cause is not Cause.SWAPPED}
    fitting = [fault for fault, row in rows.items() if _departure(greys, levels, row) <= FOLLOWS]
    explained = {f: sum(k is not None for k in np.array(rows[f])[np.isfinite(levels)]) for f in fitting}
    most = max(explained.values(), default=0)
    return tuple(fault for fault in fitting if explained[fault] == most) or None


def _departure(greys: NDArray[np.int64], levels: Floats, shown: Sequence[int | None]) -> float:
    """RMS by which levels depart from any that rise with the greys shown, as a share of their range."""
    known = np.array([k is not None for k in shown]) & np.isfinite(levels)
    grey, level = greys[[k or 0 for k in shown]][known], levels[known]
    _, place, frames = np.unique(grey, return_inverse=True, return_counts=True)
    mean = np.bincount(place, level) / frames
    curve = isotonic_regression(mean, weights=frames).x
    return float(
        np.sqrt(np.mean((level - curve[place]) ** 2)) / max(np.nanmax(levels) - np.nanmin(levels), 1e-9)
    )


def check_rig(rig: Rig, plan: Plan, item: str, progress: Progress) -> Checked:
    """Open a rig, show it the marker, stepped and where it can triggered, and name what is wrong.

    The plan gives exposure and settling time. What a device raises is a finding too.
    Raises `ConfigError` for a wrong rig file.
    """
    shown, look = marker(), _Look(plan)
    try:
        with rig:
            if rig.fixture:
                rig.fixture.mount(item)
            look.at(rig, shown, progress)
    except DeviceError as error:
        look.findings.append(_of_device(error))
    progress(1.0)
    return Checked(shown, tuple(look.runs), tuple(look.findings), look.settle_s)


class _Look:
    """What a look at an open rig has found so far: an error ends it, but not what was found before."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self.runs: list[Seen] = []
        self.findings: list[Finding] = []
        self.settle_s: float | None = None

    def at(self, rig: Rig, shown: NDArray[np.int64], progress: Progress) -> None:
        stepped = self._plan.model_copy(update={"trigger": "stepped"})
        self.runs.append(run := _run(rig, stepped, shown))
        progress(0.4)
        self.findings += _of_light(run)
        if run.rise < LEAST_RISE:
            return
        if (slipped := slips(shown, run.levels)) != ():
            self.settle_s = _settling(rig, stepped, shown)
            self.findings.append(_of_display(slipped, stepped.settle_s, self.settle_s))
        progress(0.7)
        if rig.projector.caps.trigger_outputs and "hardware" in rig.camera.caps.triggers:
            triggered = self._plan.model_copy(update={"trigger": "triggered"})
            self.runs.append(run := _run(rig, triggered, shown))
            self.findings += _of_trigger(slips(shown, run.levels), run, remedy(triggered))


def _run(rig: Rig, plan: Plan, shown: NDArray[np.int64]) -> Seen:
    """Show the marker once. Of a triggered run that ends too early what has come is judged."""
    patterns = uniform_patterns(shown.tolist(), rig.projector.caps.size)
    samples: list[NDArray[Any]] = []
    with closing(expose(rig, patterns, rig.camera_settings(plan.exposure_s), plan)) as shots:
        try:
            for shot in shots:
                every = max(1, math.isqrt(shot.image.size // PIXELS))
                samples.append(shot.image[::every, ::every] / full_scale(shot.settings.bits))
        except DeviceTimeoutError:
            if plan.trigger == "stepped" or not samples:
                raise
    seen = np.stack(samples)
    change = np.ptp(seen, axis=0)
    lit = seen[:, change >= 0.5 * np.quantile(change, 0.95)]
    levels = np.full(len(shown), np.nan)
    levels[: len(lit)] = lit.mean(axis=1)
    return Seen(plan.trigger, levels, float((lit >= 1.0).any(axis=0).mean()))


def _settling(rig: Rig, plan: Plan, shown: NDArray[np.int64]) -> float | None:
    """The first settling time with which a stepped plan is in step; None where none is."""
    for settle_s in SETTLE_S:
        if settle_s > plan.settle_s:
            run = _run(rig, plan.model_copy(update={"settle_s": settle_s}), shown)
            if slips(shown, run.levels) == ():
                return settle_s
    return None


def _of_light(run: Seen) -> list[Finding]:
    seen = f"white is brighter than black by {100 * run.rise:.2g} % of full scale"
    if run.saturated > SATURATED:
        share = f"{100 * run.saturated:.2g} % of the lit pixels are at full scale"
        return [Finding("the image is saturated", share, "shorten the plan's exposure_s or close the lens")]
    if run.rise < LEAST_RISE:
        advice = "see to lens caps, the projector's light, where both look, and the plan's exposure_s"
        return [Finding("the projector's light does not reach the camera", seen, advice)]
    return []


def _of_display(slipped: tuple[SyncFault, ...] | None, settle_s: float, needed: float | None) -> Finding:
    if needed is not None:
        return Finding(
            "the display is slower than the plan waits",
            f"with settle_s {settle_s:g} s {_words(slipped)}",
            f"put `settle_s: {needed:g}` into the plan",
        )
    return Finding(
        "stepped frames are out of step",
        _words(slipped),
        f"no settle_s up to {SETTLE_S[-1]:g} s helps: see that nothing else drives the projector",
    )


def _of_trigger(slipped: tuple[SyncFault, ...] | None, run: Seen, advice: str) -> list[Finding]:
    lost = int(np.isnan(run.levels).sum())
    if slipped == () and not lost:
        return []
    words = ["the last triggers did not expose a frame"] if slipped == () else [_words(slipped)]
    if lost:
        words.append(f"{lost} of {len(run.levels)} frames did not come")
    return [Finding("triggered frames are out of step", "; ".join(words), advice)]


def _of_device(error: DeviceError) -> Finding:
    return Finding(f"{error.device}: {error.operation}: {error.found}", type(error).__name__, error.remedy)


def _words(slipped: tuple[SyncFault, ...] | None) -> str:
    return "; or ".join(f.words() for f in slipped) if slipped else "the levels do not follow the greys"


def _or_none(level: float) -> float | None:
    return None if math.isnan(level) else level
