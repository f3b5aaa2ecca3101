"""A rig step by step, from its links to its focus, as on the first day."""

import math
from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fpplab.acquisition.acquire import READ_TIMEOUT_S, expose
from fpplab.acquisition.timing import PulseTiming, pulse_timing
from fpplab.core.conventions import Floats, full_scale
from fpplab.core.errors import DeviceError, DeviceTimeoutError, FrameLossError
from fpplab.core.progress import Progress
from fpplab.devices import Frame
from fpplab.devices.rig import Rig
from fpplab.diagnosis.causes.of_rig_check import NO_TRIGGER
from fpplab.diagnosis.causes.projector_dark import PROJECTOR_DARK
from fpplab.diagnosis.causes.saturated import SATURATED
from fpplab.diagnosis.causes.underexposed import UNDEREXPOSED
from fpplab.patterns.fringes import Pattern, make_patterns, uniform_patterns
from fpplab.patterns.plan import Plan
from fpplab.setup.live.patterns import as_fine_fringes
from fpplab.setup.rig_check.devices import device_finding
from fpplab.setup.rig_check.marker import marker
from fpplab.setup.rig_check.marker_check import LIMITS as MARKER_LIMITS
from fpplab.setup.rig_check.marker_check import recover_camera

LOST_PULSES = (
    "check the plugs of the trigger cable and the voltage at the camera's input: the camera had enough time "
    "for each pulse"
)


@dataclass(frozen=True)
class StepCheckLimits:
    """How the steps are done, and when one passes; all chosen."""

    pulses: int = 10  # of a run of several
    safe_gap_s: float = 0.1  # further time between pulses in which every camera becomes ready
    gaps_s: tuple[float, ...] = (0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 5e-4, 0.0)  # tried in turn, then less
    min_level: float = 0.3  # brightness of white as a share of full scale
    max_level: float = 0.95
    good_level: float = 0.8  # to aim at
    min_contrast: float = 0.3  # of the finest fringes; below, the lenses are out of focus
    # Longer than their shortest exposure for which patterns are shown to see whether they repeat: enough that
    # planes shown once are far from complete
    longer: float = 1.2
    # Error of a grey level as a share of white, from which on a pattern is stretched: between noise and the
    # half of white that a plane shown once makes of it
    max_grey_error: float = 0.1
    # Share of the time that a stretched pattern is lit by which the exposure may be shorter: by less, its
    # grey levels are about as wrong as by noise
    max_unseen: float = 0.02
    pixels: int = 40_000  # of a frame that are kept, about


LIMITS = StepCheckLimits()


@dataclass(frozen=True)
class CheckedStep:
    """What one step showed."""

    name: str  # the step
    ok: bool  # whether it is as it should be
    seen: str  # what was seen, with its numbers
    remedy: str = ""  # what to do; empty where all is well
    values: dict[str, Any] = field(default_factory=dict)  # the numbers of `seen`


class _Steps:
    """The steps on an open rig, and what later ones need of earlier ones."""

    def __init__(self, rig: Rig, plan: Plan) -> None:
        self._rig, self._plan = rig, plan
        self._white: Floats
        self._change: Floats

    @property
    def has_trigger(self) -> bool:
        return bool(self._rig.projector.caps.trigger_outputs) and "hardware" in self._rig.camera.caps.triggers

    def link(self) -> CheckedStep:
        infos = [device.info() for device in (self._rig.camera, self._rig.projector)]
        devices = [f"{info.model}, {info.serial or 'without a serial number'}, {info.link}" for info in infos]
        return CheckedStep("link", True, "; ".join(devices))

    def lamp(self) -> CheckedStep:
        black, white = self._take_samples(self._uniform([0, 255]), "stepped")
        self._white, self._change = white, white - black
        rise = float(np.quantile(self._change, 0.95))
        evidence = f"white is brighter than black by {100 * rise:.3g} % of full scale"
        ok = rise >= MARKER_LIMITS.min_rise
        remedy = f"{PROJECTOR_DARK.remedy}; at least {100 * MARKER_LIMITS.min_rise:g} %"
        return CheckedStep("lamp", ok, evidence, "" if ok else remedy, {"rise": rise})

    def one_pulse(self) -> CheckedStep:
        return self._check_pulses("one pulse", [255])

    def ten_pulses(self) -> CheckedStep:
        return self._check_pulses("ten pulses", marker().tolist()[: LIMITS.pulses])

    def rate(self) -> CheckedStep:
        # One image: none has to be read from flash meanwhile.
        patterns = self._uniform([255] * LIMITS.pulses)
        planned = self._timing(patterns)
        less_s = planned.light_s + planned.dark_s - planned.period_s
        fastest_s = LIMITS.safe_gap_s + planned.period_s  # as ten pulses have shown
        lost = "and none was lost at all"
        for gap_s in (*LIMITS.gaps_s, less_s / 2, less_s):
            period_s = self._timing(patterns, gap_s).period_s
            frames = len(self._take_samples(patterns, "triggered", gap_s))
            if frames < LIMITS.pulses:
                lost = f"{frames} of {LIMITS.pulses} at {1e3 * period_s:.6g} ms"
                break
            fastest_s = period_s
        ok = fastest_s <= planned.period_s
        evidence = f"all frames came with pulses {1e3 * fastest_s:.6g} ms apart, {lost}"
        evidence += f"; the plan takes {1e3 * planned.period_s:.6g} ms, by {planned.limit}"
        dead_s = fastest_s - planned.light_s - planned.dark_s
        remedy = "" if ok else f"put `dead_time_s: {dead_s:.3g}` into the rig file's section of the camera"
        values = {"shortest_period_s": fastest_s, "planned_period_s": planned.period_s}
        return CheckedStep("rate", ok, evidence, remedy, values)

    @property
    def long_patterns_s(self) -> float | None:
        """Time in s for which a pattern is shown to see whether it repeats; None where it cannot be."""
        recover_camera(self._rig)
        caps = self._rig.projector.caps
        shortest_s, readout_s = max(caps.bit_depths.values()), self._rig.camera.caps.readout_s
        repeats = max(2, math.ceil((shortest_s + readout_s) / shortest_s))
        long_s = min(repeats * shortest_s, caps.longest_s)
        return long_s if shortest_s and long_s >= LIMITS.longer * shortest_s + readout_s else None

    def long_patterns(self) -> CheckedStep:
        # Planes that are shown once give other grey levels in a part of the time than in all of it.
        assert self.long_patterns_s is not None
        caps, long_s = self._rig.projector.caps, self.long_patterns_s
        shortest_s = max(caps.bit_depths.values())
        patterns = self._uniform(marker().tolist())
        whole = self._take_samples(patterns, "stepped", exposure_s=caps.period_s or shortest_s)
        part = self._take_part(patterns, shortest_s, long_s)
        error = float(np.abs(self._greys(part) - self._greys(whole)).max())
        repeats = error <= LIMITS.max_grey_error
        shown = f"a pattern that is shown for {1e3 * long_s:.6g} ms"
        values = {"repeats": repeats, "grey_error": error}
        if repeats:
            return CheckedStep("long patterns", True, f"{shown} is repeated within it", "", values)
        evidence = (
            f"{shown} is stretched over it: {1e3 * shortest_s:.6g} ms of it have grey levels "
            f"that are wrong by {100 * error:.3g} % of white"
        )
        remedy = self._remedy_for_stretching()
        return CheckedStep("long patterns", not remedy, evidence, remedy, values)

    def _remedy_for_stretching(self) -> str:
        """What to do about the plan's own times; empty where its exposures see whole patterns."""
        if self._plan.trigger != "triggered":
            return ""
        patterns, dark_between = self._uniform(marker().tolist()), self._rig.projector.caps.dark_between
        timing = self._timing(patterns)
        lit_s = timing.light_s if dark_between else timing.period_s
        if self._plan.exposure_s >= (1.0 - LIMITS.max_unseen) * lit_s:
            return ""
        if self._rig.camera.caps.readout_s:
            return "use a global shutter, or `shutter: global_reset` with patterns in flash"
        return f"expose for as long as patterns are shown: at least {1e3 * lit_s:.6g} ms"

    def _take_part(self, patterns: Sequence[Pattern], exposure_s: float, long_s: float) -> Floats:
        """Samples of exposures from the beginning of patterns that are shown for longer than that."""
        rig, plan = self._rig, self._plan
        recover_camera(rig)
        camera, projector = rig.camera, rig.projector
        settings = camera.configure(rig.camera_settings(exposure_s, plan.bits))
        projector.load(patterns)
        dead_s = rig.file.camera.dead_s(exposure_s)
        timing = pulse_timing(camera, projector, patterns, settings.exposure_s, dead_s)
        camera.arm(len(patterns), "hardware")
        try:
            period_s = max(timing.period_s, long_s + max(timing.dark_s, projector.caps.gap_s))
            projector.play(long_s, timing.dark_s, period_s)
            frames = [camera.read(period_s + READ_TIMEOUT_S) for _ in patterns]
        finally:
            rig.make_dark()
        return np.array([_sampled(frame) for frame in frames])

    def _greys(self, frames: Floats) -> Floats:
        """Grey levels 0 to 1 of the marker in the lit part of its frames."""
        lit = self._change >= 0.5 * np.quantile(self._change, 0.95)
        if readout_s := self._rig.camera.caps.readout_s:  # rows that begin with the pattern, or nearly so
            delays_s = np.arange(lit.shape[0]) / lit.shape[0] * readout_s
            first = delays_s[lit.any(axis=1)].min()
            lit = lit & (delays_s <= first + LIMITS.max_unseen * readout_s)[:, None]
        levels = frames[:, lit].mean(axis=1)
        black, white = levels[np.argmin(marker())], levels[np.argmax(marker())]
        return np.asarray((levels - black) / (white - black))

    def exposure(self) -> CheckedStep:
        # The shortest exposure is for what is brightest, the longest for what is darkest.
        exposures_s = self._plan.exposures
        white = [self._white]
        if len(exposures_s) > 1:
            ends = min(exposures_s), max(exposures_s)
            white = [self._take_samples(self._uniform([255]), "stepped", exposure_s=each)[0] for each in ends]
        is_lit = self._change >= 0.5 * np.quantile(self._change, 0.95)
        level, saturated = float(white[-1][is_lit].mean()), float((white[0][is_lit] >= 1.0).mean())
        evidence = (
            f"white is at {100 * level:.3g} % of full scale, {100 * saturated:.2g} % of its pixels are full"
        )
        if len(exposures_s) > 1:
            evidence += f" (at {ends[1]:g} s, and at {ends[0]:g} s)"
        values = {"level": level, "saturated": saturated}
        if saturated > MARKER_LIMITS.max_saturated or (level > LIMITS.max_level and len(white) == 1):
            return CheckedStep("exposure", False, evidence, SATURATED.remedy, values)
        if level < LIMITS.min_level:
            advice = f"{UNDEREXPOSED.remedy}; by the factor {LIMITS.good_level / level:.2g}"
            return CheckedStep("exposure", False, evidence, advice, values)
        return CheckedStep("exposure", True, evidence, "", values)

    def focus(self) -> CheckedStep:
        caps = self._rig.projector.caps
        plan = self._plan.fringe_part or as_fine_fringes(self._plan, caps.size)
        finest = max(plan.fringes, key=lambda fringe: fringe.stripes)
        alone = plan.model_copy(update={"fringes": (finest,), "guided_axis": None})
        frames = self._take_samples(make_patterns(alone, caps.size, caps.lattice), "stepped")
        lit = self._change >= 0.5 * np.quantile(self._change, 0.95)
        # Of shifts by equal steps the standard deviation is the amplitude over the root of 2.
        half = self._change[lit] / 2
        contrast = float(np.median(np.sqrt(2.0) * np.std(frames, axis=0)[lit] / half))
        ok = contrast >= LIMITS.min_contrast
        evidence = f"the finest fringes, {finest.stripes:g} stripes, have a contrast of {contrast:.2g}"
        remedy = f"focus both lenses; at least {LIMITS.min_contrast:g}"
        return CheckedStep("focus", ok, evidence, "" if ok else remedy, {"contrast": contrast})

    def _check_pulses(self, name: str, greys: Sequence[int]) -> CheckedStep:
        frames = len(self._take_samples(self._uniform(greys), "triggered", LIMITS.safe_gap_s))
        evidence = f"{frames} of {len(greys)} frames came"
        ok = frames == len(greys)
        remedy = NO_TRIGGER.remedy if not frames else LOST_PULSES
        return CheckedStep(name, ok, evidence, "" if ok else remedy, {"frames": frames, "pulses": len(greys)})

    def _uniform(self, greys: Sequence[int]) -> list[Pattern]:
        return list(uniform_patterns(list(greys), self._rig.projector.caps.size))

    def _timing(self, patterns: Sequence[Pattern], gap_s: float = 0.0) -> PulseTiming:
        rig = self._rig
        recover_camera(rig)
        settings = rig.camera.configure(rig.camera_settings(self._plan.exposure_s, self._plan.bits))
        rig.projector.load(patterns)
        dead_s = rig.file.camera.dead_s(settings.exposure_s)
        return pulse_timing(rig.camera, rig.projector, patterns, settings.exposure_s, dead_s, gap_s)

    def _take_samples(
        self, patterns: Sequence[Pattern], trigger: str, gap_s: float = 0.0, exposure_s: float | None = None
    ) -> Floats:
        """Samples of the frames that came, as shares of full scale: (frames, rows, columns)."""
        rig = self._rig
        recover_camera(rig)
        plan = self._plan.model_copy(update={"trigger": trigger})
        settings = rig.camera_settings(exposure_s or plan.exposure_s, plan.bits)
        frames: list[Floats] = []
        lost = (DeviceTimeoutError, FrameLossError) if trigger == "triggered" else ()
        with closing(expose(rig, patterns, settings, plan, gap_s)) as shots, suppress(*lost):
            frames += map(_sampled, shots)
        return np.array(frames)


def _sampled(frame: Frame) -> Floats:
    every = max(1, math.isqrt(frame.image.size // LIMITS.pixels))
    return np.asarray(frame.image[::every, ::every] / full_scale(frame.settings.bits))


def check_steps(
    rig: Rig, plan: Plan, item: str, progress: Progress, tell: Callable[[CheckedStep], None]
) -> list[CheckedStep]:
    # Without light or without a first pulse, the steps that need it are left out. A rig without a trigger has
    # no steps of pulses.
    done: list[CheckedStep] = []
    steps = _Steps(rig, plan)

    def is_well(name: str, step: Callable[[], CheckedStep]) -> bool:
        try:
            checked = step()
        except DeviceError as error:
            finding = device_finding(error)
            checked = CheckedStep(name, False, finding.evidence, finding.remedy)
        done.append(checked)
        tell(checked)
        progress(len(done) / 8)  # steps at most
        return checked.ok

    with ExitStack() as stack:

        def link() -> CheckedStep:
            stack.enter_context(rig)
            plan.check_projector(rig.projector.caps.size, "plan")
            if rig.fixture:
                rig.fixture.mount(item)
            return steps.link()

        if is_well("link", link) and is_well("lamp", steps.lamp):
            if steps.has_trigger:
                pulses = is_well("one pulse", steps.one_pulse) and is_well("ten pulses", steps.ten_pulses)
                if pulses:
                    is_well("rate", steps.rate)
                    if steps.long_patterns_s is not None:
                        is_well("long patterns", steps.long_patterns)
            is_well("exposure", steps.exposure)
            is_well("focus", steps.focus)
    progress(1.0)
    return done
