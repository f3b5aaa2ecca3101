"""Synchronisation check of a rig by a marker: uniform grey-level images in an order that reveals every slip.

Levels must rise with the grey levels shown, whatever the scene. Neighbours in the order differ by a third of
all levels or more, so that a frame of another image stands out.
"""

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import isotonic_regression

from fpplab.acquisition.acquire import expose
from fpplab.acquisition.synchronisation import Cause, SyncFault, considered_faults, synchronisation_remedy
from fpplab.acquisition.timing import PulseTiming, pulse_timing
from fpplab.core.conventions import Floats, full_scale
from fpplab.core.errors import DeviceTimeoutError
from fpplab.core.progress import Progress
from fpplab.devices import State
from fpplab.devices.rig import Rig
from fpplab.diagnosis import Finding
from fpplab.diagnosis.causes.missing_colour import COLOURS, MISSING_COLOUR, colour_finding
from fpplab.diagnosis.causes.no_overlap import light_elsewhere
from fpplab.diagnosis.causes.of_rig_check import (
    CAMERA_NOT_READY,
    NO_TRIGGER,
    OUT_OF_STEP,
    SLOW_DISPLAY,
    TRIGGER_EDGE,
    TRIGGER_SHIFTED,
)
from fpplab.diagnosis.causes.projector_dark import PROJECTOR_DARK
from fpplab.diagnosis.causes.saturated import SATURATED
from fpplab.patterns.fringes import uniform_patterns
from fpplab.patterns.plan import Plan
from fpplab.setup.rig_check.devices import DECISIVE_EXCESS, does_light_flicker
from fpplab.setup.rig_check.exposure_shift import LIMITS as SHIFT_LIMITS
from fpplab.setup.rig_check.exposure_shift import ExposureShift, find_exposure_shift
from fpplab.setup.rig_check.marker import marker

UNCERTAIN_EXCESS = 1.0  # of frames out of step that another cause may explain (derived: at the limit)
SLIPS = (OUT_OF_STEP, SLOW_DISPLAY, CAMERA_NOT_READY)
"""Causes that are concluded from levels that do not rise with the grey levels shown."""


@dataclass(frozen=True)
class MarkerLimits:
    """From when on light and synchronisation are at fault."""

    min_rise: float = 0.05  # by which white is brighter than black, as a share of full scale; chosen
    max_saturated: float = 0.01  # share of the illuminated pixels at full scale; chosen
    # RMS departure of levels in step from a rising curve, as a share of their range: any slip leaves 0.02 or
    # more up to a gamma of 2.2.
    max_departure: float = 0.015
    # Further times in s between triggers that are tried for a camera that was not ready, and the one beyond
    # an exposure in which every camera becomes ready; chosen.
    gaps_s: tuple[float, ...] = (0.0, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1)
    safe_gap_s: float = 0.1
    max_dark_range: float = 0.1  # of levels that all show darkness, as a share of the marker's range; chosen
    settle_s: tuple[float, ...] = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)  # tried in turn; chosen
    pixels: int = 20_000  # of a frame that are evaluated, about; chosen


LIMITS = MarkerLimits()


@dataclass(frozen=True, eq=False)
class MarkerRun:
    """One run of the marker."""

    how: str  # "stepped" or "triggered"
    levels: Floats  # mean levels of the illuminated pixels as shares of full scale, in the order shown
    saturated: float  # share of these pixels at full scale in any frame

    @property
    def rise(self) -> float:
        return float(np.nanmax(self.levels) - np.nanmin(self.levels))

    @property
    def frames(self) -> int:
        return int(np.isfinite(self.levels).sum())


def matching_faults(shown: Sequence[int] | NDArray[np.int64], levels: Floats) -> tuple[SyncFault, ...] | None:
    # Of the faults that fit, those that explain the most frames are returned. Swapped frames are not tried,
    # because only the trigger can have slipped.
    # shown (K,); levels (K,)
    greys, in_step = np.asarray(shown), list(range(len(shown)))
    if _departure_from_monotonic(greys, levels, in_step) <= LIMITS.max_departure:
        return ()
    rows = {f: f.shown(len(greys)) for f in considered_faults(len(greys)) if f.cause is not Cause.SWAPPED}
    fitting = [
        fault
        for fault, row in rows.items()
        if _departure_from_monotonic(greys, levels, row) <= LIMITS.max_departure
    ]
    explained = {f: sum(k is not None for k in np.array(rows[f])[np.isfinite(levels)]) for f in fitting}
    most_explained = max(explained.values(), default=0)
    return tuple(fault for fault in fitting if explained[fault] == most_explained) or None


def _departure_from_monotonic(greys: NDArray[np.int64], levels: Floats, shown: Sequence[int | None]) -> float:
    """RMS by which levels depart from any that rise with the grey levels shown, as a share of their range."""
    valid = np.array([k is not None for k in shown]) & np.isfinite(levels)
    grey, level = greys[[k or 0 for k in shown]][valid], levels[valid]
    _, place, frames = np.unique(grey, return_inverse=True, return_counts=True)
    mean = np.bincount(place, level) / frames
    curve = isotonic_regression(mean, weights=frames).x
    return float(
        np.sqrt(np.mean((level - curve[place]) ** 2)) / max(np.nanmax(levels) - np.nanmin(levels), 1e-9)
    )


class MarkerInspection:
    """What the marker shows of an open rig; what was found before an error is kept."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self.runs: list[MarkerRun] = []
        self.light: list[Finding] = []
        self.findings: list[Finding] = []
        self.settle_s: float | None = None
        self._of_stepped: list[Finding] = []

    def at(self, rig: Rig, progress: Progress) -> None:
        shown = marker()
        stepped = self._plan.model_copy(update={"trigger": "stepped"})
        self.runs.append(run := _show_marker_once(rig, stepped, shown))
        progress(0.4)
        self.light = _of_light(run)
        if run.rise < LIMITS.min_rise:
            return
        if (colour := _missing_colour(shown, run.levels)) is not None:
            self.light = [colour]
            return
        if (slipped := matching_faults(shown, run.levels)) != ():
            repeated = matching_faults(shown, _show_marker_once(rig, stepped, shown).levels)
            self.settle_s = _find_settling_time(rig, stepped, shown)
            recurs = repeated != () if self.settle_s else bool({*(slipped or ())} & {*(repeated or ())})
            self.findings.append(_of_display(slipped, stepped.settle_s, self.settle_s, recurs))
        self._of_stepped = list(self.findings)
        progress(0.7)
        if rig.projector.caps.trigger_outputs and "hardware" in rig.camera.caps.triggers:
            triggered = self._plan.model_copy(update={"trigger": "triggered"})
            run = _show_marker_once(rig, triggered, shown)
            if run.frames:
                self.runs.append(run)
            self.findings += self._of_trigger(rig, triggered, shown, run)
        self._doubt_slips(rig)

    def _doubt_slips(self, rig: Rig) -> None:
        """Make slips uncertain if all frames came but the light flickers, which looks the same."""
        is_complete = all(run.frames == len(run.levels) for run in self.runs)
        if (
            not is_complete
            or not any(finding.cause in SLIPS for finding in self.findings)
            or not does_light_flicker(rig, self._plan)
        ):
            return
        self.findings, self._of_stepped = (
            [_as_uncertain(finding) for finding in findings] for findings in (self.findings, self._of_stepped)
        )

    @property
    def fringe_plan(self) -> Plan | None:
        """The plan as it is in step: triggered, or stepped and slowly enough; None where neither is."""
        if any(finding.cause == MISSING_COLOUR for finding in self.light):
            return None
        certain = [finding for finding in self._of_stepped if finding.excess > UNCERTAIN_EXCESS]
        if any(finding.cause == OUT_OF_STEP for finding in certain):
            return None
        is_triggered = self.runs[-1].how == "triggered" and self._of_stepped == self.findings
        trigger = self._plan.trigger if is_triggered else "stepped"
        return self._plan.model_copy(
            update={"trigger": trigger, "settle_s": self.settle_s or self._plan.settle_s}
        )

    def _of_trigger(self, rig: Rig, plan: Plan, shown: NDArray[np.int64], run: MarkerRun) -> list[Finding]:
        shift = None if self._of_stepped else find_exposure_shift(self.runs[0].levels, run.levels)
        if _is_in_step(shown, run):  # levels that mix a little with their neighbours rise all the same
            return [_exposure_shift_finding(shift, plan.exposure_s)] if shift else []
        if not run.frames:
            return [_no_pulse(len(shown))]
        slow_run = _show_marker_once(rig, plan, shown, plan.exposure_s + LIMITS.safe_gap_s)
        if _shows_darkness(slow_run, LIMITS.max_dark_range * self.runs[0].rise):
            return [_wrong_edge()]
        if shift is not None:
            return [_exposure_shift_finding(shift, plan.exposure_s)]
        slipped = matching_faults(shown, run.levels)
        if not _is_in_step(shown, slow_run):
            repeated = matching_faults(shown, slow_run.levels)
            return [
                _slipped_frames_finding(
                    slipped,
                    run,
                    synchronisation_remedy(plan),
                    happens_again=bool({*(slipped or ())} & {*(repeated or ())}),
                )
            ]
        gap_s = next(
            (s for s in LIMITS.gaps_s if _is_in_step(shown, _show_marker_once(rig, plan, shown, s))),
            LIMITS.safe_gap_s,
        )
        if gap_s == 0.0:
            return [
                _slipped_frames_finding(
                    slipped,
                    run,
                    synchronisation_remedy(plan),
                    "when it was repeated, all frames were in step",
                )
            ]
        timing = _timing(rig, plan, shown, gap_s)
        dead_s = math.ceil(1e4 * (timing.period_s - timing.light_s - timing.dark_s)) / 1e4
        return [_not_ready(run, gap_s, dead_s)]


def _as_uncertain(finding: Finding) -> Finding:
    return replace(finding, excess=UNCERTAIN_EXCESS) if finding.cause in SLIPS else finding


def _missing_colour(shown: NDArray[np.int64], levels: Floats) -> Finding | None:
    """A third of the frames darker than the curve by which the others rise with the grey levels."""
    if (
        not np.isfinite(levels).all()
        or _departure_from_monotonic(shown, levels, range(len(shown))) <= LIMITS.max_departure
    ):
        return None
    places = np.arange(len(shown))
    for colour in range(COLOURS):
        others = places % COLOURS != colour
        if (
            _departure_from_monotonic(shown[others], levels[others], range(int(others.sum())))
            > LIMITS.max_departure
        ):
            continue
        order = np.argsort(shown[others])
        expected = np.interp(shown, shown[others][order], levels[others][order])
        dark = float(levels.min())
        relative = (levels - dark + 0.1 * np.ptp(levels)) / (expected - dark + 0.1 * np.ptp(levels))
        if (finding := colour_finding(np.where(others, 1.0, relative), places)) is not None:
            return replace(finding, excess=DECISIVE_EXCESS)
    return None


def recover_camera(rig: Rig) -> None:
    if rig.camera.state is State.FAULT:
        rig.camera.close()
        rig.camera.open()


def _show_marker_once(rig: Rig, plan: Plan, shown: NDArray[np.int64], gap_s: float = 0.0) -> MarkerRun:
    """Show the marker once. A triggered run that ends too early is judged by the frames that came."""
    recover_camera(rig)
    patterns = uniform_patterns(shown.tolist(), rig.projector.caps.size)
    settings = rig.camera_settings(plan.exposure_s, plan.bits)
    samples: list[NDArray[Any]] = []
    with closing(expose(rig, patterns, settings, plan, gap_s)) as shots:
        try:
            for shot in shots:
                every = max(1, math.isqrt(shot.image.size // LIMITS.pixels))
                samples.append(shot.image[::every, ::every] / full_scale(shot.settings.bits))
        except DeviceTimeoutError:
            if plan.trigger == "stepped":
                raise
    if not samples:
        return MarkerRun(plan.trigger, np.full(len(shown), np.nan), 0.0)
    images = np.stack(samples)
    change = np.ptp(images, axis=0)
    illuminated = images[:, change >= 0.5 * np.quantile(change, 0.95)]
    levels = np.full(len(shown), np.nan)
    levels[: len(illuminated)] = illuminated.mean(axis=1)
    return MarkerRun(plan.trigger, levels, float((illuminated >= 1.0).any(axis=0).mean()))


def _find_settling_time(rig: Rig, plan: Plan, shown: NDArray[np.int64]) -> float | None:
    for settle_s in LIMITS.settle_s:
        slower = plan.model_copy(update={"settle_s": settle_s})
        if settle_s > plan.settle_s and all(
            _is_in_step(shown, _show_marker_once(rig, slower, shown)) for _ in range(2)
        ):
            return settle_s
    return None


def _of_light(run: MarkerRun) -> list[Finding]:
    if run.saturated > LIMITS.max_saturated:
        share = f"{100 * run.saturated:.2g} % of the illuminated pixels are at full scale"
        return [Finding(SATURATED, share, run.saturated / LIMITS.max_saturated)]
    if run.rise < LIMITS.min_rise:
        evidence = f"white is brighter than black by {100 * run.rise:.2g} % of full scale"
        advice = "check the lens caps, the projector's light, where both look, and the plan's exposure_s"
        excess = LIMITS.min_rise / max(run.rise, 1e-4)
        return [Finding(PROJECTOR_DARK, evidence, excess, advice), light_elsewhere(excess)]
    return []


def _of_display(
    slipped: tuple[SyncFault, ...] | None, settle_s: float, needed: float | None, recurs: bool
) -> Finding:
    """Frames of a stepped run out of step. A slip that does not recur may be light that flickers."""
    excess = DECISIVE_EXCESS if recurs else UNCERTAIN_EXCESS
    if needed is not None:
        evidence = f"with settle_s {settle_s:g} s {_slip_description(slipped)}"
        return Finding(SLOW_DISPLAY, evidence, excess, f"put `settle_s: {needed:g}` into the plan")
    advice = (
        f"no settle_s up to {LIMITS.settle_s[-1]:g} s helps: make sure that nothing else drives the projector"
    )
    return Finding(OUT_OF_STEP, f"stepped: {_slip_description(slipped)}", excess, advice)


def _is_in_step(shown: NDArray[np.int64], run: MarkerRun) -> bool:
    return run.frames == len(shown) and matching_faults(shown, run.levels) == ()


def _shows_darkness(run: MarkerRun, max_range: float) -> bool:
    """Whether most frames came and all but the last show the same level: after the last nothing is shown."""
    return run.frames > len(run.levels) // 2 and float(np.ptp(run.levels[: run.frames][:-1])) < max_range


def _timing(rig: Rig, plan: Plan, shown: NDArray[np.int64], gap_s: float) -> PulseTiming:
    patterns = uniform_patterns(shown.tolist(), rig.projector.caps.size)
    dead_s = rig.file.camera.dead_s(plan.exposure_s)
    return pulse_timing(rig.camera, rig.projector, patterns, plan.exposure_s, dead_s, gap_s)


def _slipped_frames_finding(
    slipped: tuple[SyncFault, ...] | None,
    run: MarkerRun,
    advice: str,
    addition: str = "",
    happens_again: bool = False,
) -> Finding:
    """Frames out of step. A slip that occurs once may be flickering light, which the fringes show."""
    lost = len(run.levels) - run.frames
    evidence = ["the last triggers did not expose a frame"] if slipped == () else [_slip_description(slipped)]
    if lost:
        evidence.append(f"{lost} of {len(run.levels)} frames did not come")
    if addition:
        evidence.append(addition)
    excess = DECISIVE_EXCESS if happens_again or lost else UNCERTAIN_EXCESS
    return Finding(OUT_OF_STEP, f"triggered: {'; '.join(evidence)}", excess, advice)


def _no_pulse(count: int) -> Finding:
    return Finding(NO_TRIGGER, f"none of {count} frames came", DECISIVE_EXCESS)


def _wrong_edge() -> Finding:
    evidence = "with darkness between the patterns, the frames show the darkness"
    return Finding(TRIGGER_EDGE, evidence, DECISIVE_EXCESS)


def _exposure_shift_finding(shift: ExposureShift, exposure_s: float) -> Finding:
    direction, neighbour = ("late", "next") if shift.is_late else ("early", "previous")
    evidence = (
        f"{100 * shift.share:.0f} % of each exposure show the {neighbour} pattern: exposures begin about "
        f"{1e3 * shift.share * exposure_s:.3g} ms too {direction}"
    )
    return Finding(TRIGGER_SHIFTED, evidence, shift.share / SHIFT_LIMITS.min_share)


def _not_ready(run: MarkerRun, gap_s: float, dead_s: float) -> Finding:
    """The camera is not ready. Where no frame is lost, light that flickers may be behind it."""
    return Finding(
        CAMERA_NOT_READY,
        f"{run.frames} of {len(run.levels)} frames came; with {1e3 * gap_s:g} ms more between triggers all "
        "come",
        DECISIVE_EXCESS if run.frames < len(run.levels) else UNCERTAIN_EXCESS,
        f"put `dead_time_s: {dead_s:g}` into the rig file's section of the camera",
    )


def _slip_description(slipped: tuple[SyncFault, ...] | None) -> str:
    return (
        "; or ".join(f.describe() for f in slipped)
        if slipped
        else "the levels do not rise with the grey levels"
    )
