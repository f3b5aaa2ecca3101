"""Synchronisation check of a rig by a marker: uniform grey-level images in an order that reveals every slip.

The levels that a camera sees of uniform grey-level images must rise with them, whatever the response, the
scene and the exposure. In the order shown neighbours differ by a third of all levels or more, so that a
frame that shows another's grey level stands out, and each fault of `synchronisation` either fits the levels
that were seen or does not.
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
from fpplab.acquisition.timing import PulseTiming, pulse_timing
from fpplab.core.conventions import Floats, full_scale
from fpplab.core.errors import DeviceError, DeviceTimeoutError
from fpplab.core.progress import Progress
from fpplab.devices import State
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import uniform_patterns
from fpplab.patterns.plan import Plan

MARKER_ORDER = (7, 0, 5, 9, 4, 8, 3, 10, 1, 6, 2, 11)
"""Levels by their rank, 0 the darkest. Twelve fill the places of four 24-bit images. Of orders whose
neighbours differ by four steps or more this one, of many tried, leaves the greatest departure between any two
slips: 6 % of the range, 2 % at a gamma of 2.2. Both its ends are brighter than the darkness around it.
"""
LEAST_RISE = 0.05
"""Share of full scale by which white must be brighter than black."""
SATURATED = 0.01
"""Share of the illuminated pixels at full scale beyond which the exposure is too long."""
MOST_DEPARTURE = 0.015
"""Greatest RMS departure of the levels from a rising curve, as a share of their range, of frames in step."""
APART_S = 0.1
"""Further time in s between triggers beyond an exposure, in which every camera becomes ready."""
GAPS_S = (0.0, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1)
"""Further times in s between triggers that are tried for a camera that was not ready."""
SAME_LEVEL = 0.1
"""Range of levels of frames that all show darkness, as a share of that of the marker."""
SETTLE_S = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
"""Settling times that are tried, in s."""
PIXELS = 20_000
"""About how many pixels of a frame are evaluated."""


@dataclass(frozen=True)
class Finding:
    """One fault of a rig.

    Attributes
    ----------
    cause : str
        What is wrong.
    evidence : str
        How it shows.
    remedy : str
        What the operator can do.
    """

    cause: str
    evidence: str
    remedy: str


@dataclass(frozen=True, eq=False)
class MarkerRun:
    """One run of the marker.

    Attributes
    ----------
    how : str
        "stepped" or "triggered".
    levels : ndarray of float64, (K,)
        Mean levels of the illuminated pixels as shares of full scale, in the order shown; NaN where no frame
        came.
    saturated : float
        Share of these pixels at full scale in any frame.
    """

    how: str
    levels: Floats
    saturated: float

    @property
    def rise(self) -> float:
        """Difference between the brightest and the darkest level, as a share of full scale."""
        return float(np.nanmax(self.levels) - np.nanmin(self.levels))

    @property
    def frames(self) -> int:
        """Number of frames that came."""
        return int(np.isfinite(self.levels).sum())


@dataclass(frozen=True, eq=False)
class SyncCheck:
    """Result of `check_rig`.

    Attributes
    ----------
    shown : ndarray of int64, (K,)
        Grey levels of 255 in the order shown.
    runs : tuple of MarkerRun
        The stepped run, and the triggered one where the rig can.
    findings : tuple of Finding
        What is wrong; empty when all is well.
    settle_s : float or None
        The settling time in s that a stepped plan needs, where the plan's was too short and a longer one
        served.
    """

    shown: NDArray[np.int64]
    runs: tuple[MarkerRun, ...]
    findings: tuple[Finding, ...]
    settle_s: float | None = None

    def summary(self) -> dict[str, Any]:
        """Give the result as plain values.

        Returns
        -------
        dict
            The keys of `fpplab check --json`.
        """
        return {
            "ok": not self.findings,
            "findings": [asdict(finding) for finding in self.findings],
            "settle_s": self.settle_s,
            "shown": self.shown.tolist(),
            "seen": {run.how: [_or_none(level) for level in run.levels.tolist()] for run in self.runs},
        }


def marker() -> NDArray[np.int64]:
    """Compute the grey levels of the marker.

    Returns
    -------
    ndarray of int64, (12,)
        Grey levels of 255 in the order shown.
    """
    return np.asarray(np.rint(np.array(MARKER_ORDER) * 255 / (len(MARKER_ORDER) - 1)), np.int64)


def matching_faults(shown: Sequence[int] | NDArray[np.int64], levels: Floats) -> tuple[SyncFault, ...] | None:
    """Find the synchronisation faults under which the levels seen rise with the grey levels shown.

    Of the faults that fit, those that explain the most frames are returned. Swapped frames are not tried,
    because only the trigger can have slipped.

    Parameters
    ----------
    shown : sequence of int, or ndarray of int64, (K,)
        Grey levels in the order shown.
    levels : ndarray of float64, (K,)
        Levels seen, NaN where no frame came.

    Returns
    -------
    tuple of SyncFault, or None
        Empty when in step, None when no fault explains the levels.
    """
    greys, in_step = np.asarray(shown), list(range(len(shown)))
    if _departure(greys, levels, in_step) <= MOST_DEPARTURE:
        return ()
    rows = {f: f.shown(len(greys)) for f in faults(len(greys)) if f.cause is not Cause.SWAPPED}
    fitting = [fault for fault, row in rows.items() if _departure(greys, levels, row) <= MOST_DEPARTURE]
    explained = {f: sum(k is not None for k in np.array(rows[f])[np.isfinite(levels)]) for f in fitting}
    most = max(explained.values(), default=0)
    return tuple(fault for fault in fitting if explained[fault] == most) or None


def _departure(greys: NDArray[np.int64], levels: Floats, shown: Sequence[int | None]) -> float:
    """RMS by which levels depart from any that rise with the grey levels shown, as a share of their range."""
    known = np.array([k is not None for k in shown]) & np.isfinite(levels)
    grey, level = greys[[k or 0 for k in shown]][known], levels[known]
    _, place, frames = np.unique(grey, return_inverse=True, return_counts=True)
    mean = np.bincount(place, level) / frames
    curve = isotonic_regression(mean, weights=frames).x
    return float(
        np.sqrt(np.mean((level - curve[place]) ** 2)) / max(np.nanmax(levels) - np.nanmin(levels), 1e-9)
    )


def check_rig(rig: Rig, plan: Plan, item: str, progress: Progress) -> SyncCheck:
    """Open a rig, show it the marker, stepped and where possible triggered, and report what is wrong.

    What a device raises is a finding too.

    Parameters
    ----------
    rig : Rig
        A rig that is not open; it is closed afterwards.
    plan : Plan
        Gives exposure and settling time.
    item : str
        Name of the item that is mounted where the rig has a fixture, such as an evenly white card.
    progress : Progress
        Called with the share that is done.

    Returns
    -------
    SyncCheck
        Levels seen and findings.

    Raises
    ------
    ConfigError
        The rig file is wrong.
    """
    shown, inspection = marker(), _RigInspection(plan)
    try:
        with rig:
            if rig.fixture:
                rig.fixture.mount(item)
            inspection.at(rig, shown, progress)
    except DeviceError as error:
        inspection.findings.append(_of_device(error))
    progress(1.0)
    return SyncCheck(shown, tuple(inspection.runs), tuple(inspection.findings), inspection.settle_s)


class _RigInspection:
    """State of the check of an open rig: an error ends it, but what was found before is kept."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self.runs: list[MarkerRun] = []
        self.findings: list[Finding] = []
        self.settle_s: float | None = None

    def at(self, rig: Rig, shown: NDArray[np.int64], progress: Progress) -> None:
        stepped = self._plan.model_copy(update={"trigger": "stepped"})
        self.runs.append(run := _run(rig, stepped, shown))
        progress(0.4)
        self.findings += _of_light(run)
        if run.rise < LEAST_RISE:
            return
        if (slipped := matching_faults(shown, run.levels)) != ():
            self.settle_s = _settling(rig, stepped, shown)
            self.findings.append(_of_display(slipped, stepped.settle_s, self.settle_s))
        progress(0.7)
        if rig.projector.caps.trigger_outputs and "hardware" in rig.camera.caps.triggers:
            triggered = self._plan.model_copy(update={"trigger": "triggered"})
            run = _run(rig, triggered, shown)
            if run.frames:
                self.runs.append(run)
            self.findings += self._of_trigger(rig, triggered, shown, run)

    def _of_trigger(self, rig: Rig, plan: Plan, shown: NDArray[np.int64], run: MarkerRun) -> list[Finding]:
        """Tell what is wrong with a triggered run, by a second one with more time between triggers."""
        if _is_in_step(shown, run):
            return []
        if not run.frames:
            return [_no_pulse(len(shown))]
        apart = _run(rig, plan, shown, plan.exposure_s + APART_S)
        if apart.frames and np.ptp(apart.levels[: apart.frames][:-1]) < SAME_LEVEL * self.runs[0].rise:
            return [_wrong_edge()]
        if not _is_in_step(shown, apart):
            return [_slipped(matching_faults(shown, run.levels), run, remedy(plan))]
        gap_s = next((s for s in GAPS_S if _is_in_step(shown, _run(rig, plan, shown, s))), APART_S)
        if gap_s == 0.0:
            once = "when it was repeated, all frames were in step"
            return [_slipped(matching_faults(shown, run.levels), run, remedy(plan), once)]
        timing = _timing(rig, plan, shown, gap_s)
        dead_s = math.ceil(1e4 * (timing.period_s - timing.light_s - timing.dark_s)) / 1e4
        return [_not_ready(run, gap_s, dead_s)]


def _run(rig: Rig, plan: Plan, shown: NDArray[np.int64], gap_s: float = 0.0) -> MarkerRun:
    """Show the marker once. A triggered run that ends too early is judged by the frames that came."""
    if rig.camera.state is State.FAULT:  # after a run whose frames did not all come
        rig.camera.close()
        rig.camera.open()
    patterns = uniform_patterns(shown.tolist(), rig.projector.caps.size)
    settings = rig.camera_settings(plan.exposure_s, plan.bits)
    samples: list[NDArray[Any]] = []
    with closing(expose(rig, patterns, settings, plan, gap_s)) as shots:
        try:
            for shot in shots:
                every = max(1, math.isqrt(shot.image.size // PIXELS))
                samples.append(shot.image[::every, ::every] / full_scale(shot.settings.bits))
        except DeviceTimeoutError:
            if plan.trigger == "stepped":
                raise
    if not samples:
        return MarkerRun(plan.trigger, np.full(len(shown), np.nan), 0.0)
    seen = np.stack(samples)
    change = np.ptp(seen, axis=0)
    illuminated = seen[:, change >= 0.5 * np.quantile(change, 0.95)]
    levels = np.full(len(shown), np.nan)
    levels[: len(illuminated)] = illuminated.mean(axis=1)
    return MarkerRun(plan.trigger, levels, float((illuminated >= 1.0).any(axis=0).mean()))


def _settling(rig: Rig, plan: Plan, shown: NDArray[np.int64]) -> float | None:
    """The first settling time with which a stepped plan is in step; None where none is."""
    for settle_s in SETTLE_S:
        if settle_s > plan.settle_s:
            run = _run(rig, plan.model_copy(update={"settle_s": settle_s}), shown)
            if matching_faults(shown, run.levels) == ():
                return settle_s
    return None


def _of_light(run: MarkerRun) -> list[Finding]:
    seen = f"white is brighter than black by {100 * run.rise:.2g} % of full scale"
    if run.saturated > SATURATED:
        share = f"{100 * run.saturated:.2g} % of the illuminated pixels are at full scale"
        return [Finding("the image is saturated", share, "shorten the plan's exposure_s or close the lens")]
    if run.rise < LEAST_RISE:
        advice = "check the lens caps, the projector's light, where both look, and the plan's exposure_s"
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
        f"no settle_s up to {SETTLE_S[-1]:g} s helps: make sure that nothing else drives the projector",
    )


def _is_in_step(shown: NDArray[np.int64], run: MarkerRun) -> bool:
    return run.frames == len(shown) and matching_faults(shown, run.levels) == ()


def _timing(rig: Rig, plan: Plan, shown: NDArray[np.int64], gap_s: float) -> PulseTiming:
    patterns = uniform_patterns(shown.tolist(), rig.projector.caps.size)
    dead_s = rig.file.camera.dead_time_s
    return pulse_timing(rig.camera, rig.projector, patterns, plan.exposure_s, dead_s, gap_s)


def _slipped(slipped: tuple[SyncFault, ...] | None, run: MarkerRun, advice: str, more: str = "") -> Finding:
    lost = len(run.levels) - run.frames
    words = ["the last triggers did not expose a frame"] if slipped == () else [_words(slipped)]
    if lost:
        words.append(f"{lost} of {len(run.levels)} frames did not come")
    if more:
        words.append(more)
    return Finding("triggered frames are out of step", "; ".join(words), advice)


def _no_pulse(count: int) -> Finding:
    return Finding(
        "no trigger pulse reaches the camera",
        f"none of {count} frames came",
        "check the trigger cable, the camera's `line`, its input's voltage, and the projector's output 1",
    )


def _wrong_edge() -> Finding:
    return Finding(
        "the camera exposes at the wrong edge of the trigger pulse",
        "with darkness between the patterns, the frames show the darkness",
        "choose the other `edge` of the camera's trigger, or the other polarity (`inverted`) of the "
        "projector's output 1; see to the trigger's delay",
    )


def _not_ready(run: MarkerRun, gap_s: float, dead_s: float) -> Finding:
    return Finding(
        "the camera is not ready yet when the next trigger comes",
        f"{run.frames} of {len(run.levels)} frames came; with {1e3 * gap_s:g} ms more between triggers all "
        "come",
        f"put `dead_time_s: {dead_s:g}` into the rig file's section of the camera",
    )


def _of_device(error: DeviceError) -> Finding:
    return Finding(f"{error.device}: {error.operation}: {error.found}", type(error).__name__, error.remedy)


def _words(slipped: tuple[SyncFault, ...] | None) -> str:
    return (
        "; or ".join(f.describe() for f in slipped)
        if slipped
        else "the levels do not rise with the grey levels"
    )


def _or_none(level: float) -> float | None:
    return None if math.isnan(level) else level
