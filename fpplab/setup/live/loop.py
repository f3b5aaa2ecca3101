"""The loop of the set-up: show a pattern, take a frame, measure, obey; let other commands have the rig."""

import shutil
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from queue import Empty

import numpy as np

from fpplab.core.conventions import Mask, full_scale
from fpplab.core.errors import (
    CapabilityError,
    ConfigError,
    DataError,
    LimitError,
    SettingError,
    StateError,
    SyncError,
)
from fpplab.devices import CameraSettings, Frame
from fpplab.devices.rig import Rig
from fpplab.devices.rig_lock import RigTurn
from fpplab.patterns.fringes import Pattern
from fpplab.patterns.plan import Plan
from fpplab.pipeline.taking import take_or_resume_session
from fpplab.sessions.session import Session
from fpplab.setup.live.coverage import BoardCoverage
from fpplab.setup.live.expectation import WorkingPoint
from fpplab.setup.live.exposure import ExposureAdvice, ExposureLimits, advise_exposure
from fpplab.setup.live.measuring import LiveMeasures
from fpplab.setup.live.orders import VIEW_ORDERS, WORDS, Order, Orders
from fpplab.setup.live.pattern_watch import PatternWatch
from fpplab.setup.live.patterns import LivePatterns, View, loaded_patterns
from fpplab.setup.live.status import LiveStatus, StageState
from fpplab.targets import Target

EXPOSURE_STEP = 2.0**0.5  # factor by which one key changes the exposure (chosen)

GAIN_STEP_DB = 1.0  # change of gain by one key, in dB (chosen)

REFUSALS = (SettingError, CapabilityError, LimitError, StateError, ConfigError, DataError, SyncError)
"""Errors that refuse an order, after which the set-up continues. Any other is a fault of a device."""

LiveObserver = Callable[[LiveStatus, Frame | None, Pattern | None, Mask | None], bool]
"""What shows the set-up: a viewer, a page, a terminal."""


@dataclass(frozen=True)
class LiveOptions:
    """What the set-up is for."""

    plan: Plan  # that will be measured with
    working: WorkingPoint | None = None  # what the geometry promises, with a calibration
    target: Target | None = None  # the board of the poses that are taken
    poses: Path | None = None  # folder of their sessions
    item: str | None = None  # what the rig's fixture mounts
    stage_step_mm: float = 1.0  # how far one key moves the stage, in mm
    frames: int | None = None  # after how many frames to end; None for never
    seconds: float | None = None  # after how many seconds to end; None for never


class _RigWanted(Exception):  # noqa: N818 - no error: another command's turn
    """Ends the taking of a pose, because another command wants the rig."""


class LiveSetUp:
    """The set-up at a bench; made for one run."""

    def __init__(self, rig: Rig, options: LiveOptions, orders: Orders, observe: LiveObserver) -> None:
        self._rig, self._options, self._orders, self._observe = rig, options, orders, observe
        self._measures = LiveMeasures(options.working)
        self._settings: CameraSettings | None = None
        self._advice: ExposureAdvice | None = None
        self._view, self._turn_of_view, self._seeks = View.MEASURE, 0, 0
        self._frames, self._pauses, self._pose = 0, 0, 0
        self._times: deque[float] = deque(maxlen=20)  # frames by which the rate is computed
        self._message = ""
        self._paused_for: str | None = None
        self._over, self._end_s = False, float("inf")
        self._coverage: BoardCoverage | None = None
        self._counting: Future[str] | None = None
        self._stage: StageState | None = None
        self._geometry = None if options.working is None else options.working.summary()

    @property
    def status(self) -> LiveStatus:
        measures = self._measures
        first, last = (self._times[0], self._times[-1]) if self._times else (0.0, 0.0)
        return LiveStatus(
            frames=self._frames,
            rate_hz=(len(self._times) - 1) / (last - first) if last > first else None,
            view=self._view,
            views=tuple(self._patterns.views) if self._frames else (),
            settings=self._settings,
            levels=measures.levels,
            advice=self._advice,
            camera_focus=measures.camera_focus,
            projector_focus=measures.projector_focus,
            findings=measures.findings,
            geometry=self._geometry,
            noise_um=measures.noise_um,
            marks=measures.marks,
            coverage=None if self._coverage is None else self._coverage.summary(),
            stage=self._stage,
            message=self._message,
            paused_for=self._paused_for,
            pauses=self._pauses,
        )

    @property
    def poses(self) -> tuple[Path, ...]:
        return tuple(self._coverage.sessions) if self._coverage else ()

    def run(self, turn: RigTurn) -> LiveStatus:
        # Devices are open only while it is this command's turn; closing them leaves the projector dark.
        if self._options.seconds is not None:
            self._end_s = time.monotonic() + self._options.seconds
        with ThreadPoolExecutor(1) as self._worker:
            while not self._has_ended():
                if not turn.take():
                    self._pause_once_while_rig_is_busy(turn)
                    continue
                try:
                    if self._paused_for is not None:
                        self._paused_for, self._message = None, "the rig is free again"
                    with self._rig:
                        self._prepare_on_open_rig()
                        while not self._has_ended() and not turn.is_requested():
                            self._obey_and_take_frame(turn)
                finally:
                    turn.yield_rig()
        self._counted()
        return self.status

    def _has_ended(self) -> bool:
        frames = self._options.frames
        spent = frames is not None and self._frames >= frames
        return self._over or spent or time.monotonic() >= self._end_s

    def _pause_once_while_rig_is_busy(self, turn: RigTurn) -> None:
        if self._paused_for is None:
            self._pauses += 1
        self._paused_for = turn.requested_by()
        self._show(None, None)
        time.sleep(0.05)  # s until the turn is checked again
        while not self._orders.empty():
            if self._orders.get() is Order.QUIT:
                self._over = True

    def _prepare_on_open_rig(self) -> None:
        rig, options = self._rig, self._options
        if options.item is not None:
            rig.need_fixture(f"--item {options.item}").mount(options.item, self._pose)
        self._limits = ExposureLimits.by_devices(rig.camera.caps, rig.projector.caps, options.plan)
        self._patterns: LivePatterns = loaded_patterns(options.plan, rig.projector)
        self._settings = self._settings or rig.camera_settings(options.plan.exposure_s, options.plan.bits)
        if options.target is not None and self._coverage is None:
            projector, depth_mm = rig.projector.caps, options.plan.depth_mm or rig.file.depth_mm
            self._coverage = BoardCoverage(
                options.target, rig.camera.caps.size, projector.size, projector.lattice, depth_mm
            )
        self._watch_patterns()
        self._read_stage()

    def _watch_patterns(self) -> None:
        assert self._settings is not None
        plan = self._options.plan
        self._watch = PatternWatch(self._rig, self._patterns.patterns, self._settings, plan.settle_s)
        self._settings = self._watch.settings
        if self._frames == 0:
            dark = self._watch.dark_frame()
            self._measures.black = float(np.median(dark.image)) / full_scale(dark.settings.bits)
        self._begin_view()

    def _begin_view(self, view: View | None = None) -> None:
        self._view, self._turn_of_view = view or self._view, 0
        self._advice = None
        caps, camera = self._rig.projector.caps, self._rig.camera.caps
        self._measures.begin(self._patterns, self._view, caps.size, camera.bayer)

    def _obey_and_take_frame(self, turn: RigTurn) -> None:
        try:
            order = self._orders.get_nowait()
        except Empty:
            order = None
        if order is not None:
            self._obey_order(order, turn)
        if self._has_ended() or turn.is_requested():
            return
        self._counted()
        shown = self._patterns.views[self._view]
        index = shown[self._turn_of_view % len(shown)]
        self._turn_of_view += 1
        frame = self._watch.frame(index)
        self._frames += 1
        self._times.append(time.monotonic())
        if self._measures.add(frame):
            self._advise_exposure()
        self._show(frame, self._patterns.patterns[index])

    def _show(self, frame: Frame | None, pattern: Pattern | None) -> None:
        dark = None if frame is None else self._measures.dark(frame.settings.bits)
        if not self._observe(self.status, frame, pattern, dark):
            self._over = True

    def _advise_exposure(self) -> None:
        levels, settings = self._measures.levels, self._settings
        assert settings is not None
        self._advice = None if levels is None else advise_exposure(levels, settings, self._limits)
        if self._seeks == 0 or self._advice is None:
            return
        if self._advice.is_right:
            self._seeks, self._message = 0, f"exposed as advised: {_settings_text(settings)}"
        else:
            self._seeks -= 1
            self._configure(self._advice.exposure_s, self._advice.gain_db)

    def _configure(self, exposure_s: float, gain_db: float) -> None:
        assert self._settings is not None
        settings = replace(self._settings, exposure_s=exposure_s, gain_db=gain_db)
        self._settings = self._watch.configure(settings)
        self._message = _settings_text(self._settings)
        self._begin_view()

    def _take_advice(self) -> None:
        if self._view is View.BLACK:
            self._begin_view(View.MEASURE)
        self._seeks = 6  # steps at most, where one is not enough because the image was saturated
        if self._advice is None:
            self._message = "the exposure is being measured"
            return
        limits = "; ".join(self._advice.limits)
        self._advise_exposure()
        self._message = f"{self._message}; {limits}" if limits else self._message

    def _obey_order(self, order: Order, turn: RigTurn) -> None:
        assert self._settings is not None
        if order is not Order.ADVICE:
            self._seeks = 0
        try:
            self._carry_out_order(order, turn)
        except REFUSALS as error:
            self._seeks, self._message = 0, str(error)

    def _carry_out_order(self, order: Order, turn: RigTurn) -> None:
        assert self._settings is not None
        exposure_s, gain_db = self._settings.exposure_s, self._settings.gain_db
        step_mm = self._options.stage_step_mm
        actions: dict[Order, Callable[[], None]] = {
            Order.LONGER: lambda: self._configure(self._limits.stepped(exposure_s, EXPOSURE_STEP), gain_db),
            Order.SHORTER: lambda: self._configure(
                self._limits.stepped(exposure_s, 1.0 / EXPOSURE_STEP), gain_db
            ),
            Order.MORE_GAIN: lambda: self._configure(exposure_s, gain_db + GAIN_STEP_DB),
            Order.LESS_GAIN: lambda: self._configure(exposure_s, gain_db - GAIN_STEP_DB),
            Order.ADVICE: self._take_advice,
            Order.FORWARD: lambda: self._move_stage(step_mm),
            Order.BACK: lambda: self._move_stage(-step_mm),
            Order.HOME: self._home,
            Order.TAKE: lambda: self._take_pose(turn),
            Order.NEXT_POSE: self._next_pose,
            Order.RESET: self._reset,
            Order.QUIT: self._quit,
        }
        if order in VIEW_ORDERS:
            self._choose_view(VIEW_ORDERS[order])
        else:
            actions[order]()

    def _choose_view(self, view: View) -> None:
        if view not in self._patterns.views:
            self._message = f"the projector's memory has no {view} image; it shows the plan's own patterns"
            return
        self._message = WORDS[Order(view.value)][1]
        self._begin_view(view)

    def _reset(self) -> None:
        self._measures.forget_focus()
        self._message = "the best focus so far is forgotten"

    def _quit(self) -> None:
        self._over = True

    def _read_stage(self) -> None:
        stage = self._rig.stage
        self._stage = None if stage is None else StageState(stage.homed, stage.position_mm)

    def _move_stage(self, by_mm: float) -> None:
        stage = self._rig.stage
        if stage is None:
            self._message = "the rig has no stage"
            return
        stage.move_to(stage.position_mm + by_mm)
        self._moved()

    def _home(self) -> None:
        if self._rig.stage is None:
            self._message = "the rig has no stage"
            return
        self._rig.stage.home()
        self._moved()

    def _moved(self) -> None:
        self._read_stage()
        assert self._stage is not None
        self._message = f"the stage is at {self._stage.position_mm:g} mm"
        self._begin_view()

    def _next_pose(self) -> None:
        item = self._options.item
        if item is None:
            self._message = "no --item was given for the fixture to mount; move the board by hand"
            return
        self._rig.need_fixture(f"--item {item}").mount(item, self._pose + 1)
        self._pose += 1
        self._message = f"{item} in pose {self._pose}"
        self._begin_view()

    def _take_pose(self, turn: RigTurn) -> None:
        folder = self._options.poses
        if folder is None or self._coverage is None:
            self._message = "give --target with the file of your board to take poses of it"
            return
        if self._counting is not None:
            self._message = "the previous pose is still being evaluated"
            return
        out = _free_place(folder)
        try:
            session = self._pose_taken(out, turn)
        except BaseException as error:
            shutil.rmtree(out, ignore_errors=True)  # a pose cannot be resumed: the board is moved meanwhile
            if not isinstance(error, (*REFUSALS, _RigWanted)):
                raise
            self._message = f"{error}; take the pose again"
        else:
            self._message = f"{out.name} is taken"
            self._counting = self._worker.submit(self._coverage.add, session)
        self._watch_patterns()

    def _pose_taken(self, out: Path, turn: RigTurn) -> Session:
        settings, rig = self._settings, self._rig
        assert settings is not None
        camera = rig.file.camera.model_copy(update={"gain_db": settings.gain_db})
        rig.file = rig.file.model_copy(update={"camera": camera})
        plan = self._options.plan.model_copy(update={"exposure_s": settings.exposure_s})
        mounted = None if self._options.item is None else (self._options.item, self._pose)

        def yields(_: Frame) -> None:
            if turn.is_requested():
                raise _RigWanted("another command wanted the rig")

        return take_or_resume_session(rig, plan, out, mounted, observe_frame=yields)

    def _counted(self) -> None:
        if self._counting is not None and self._counting.done():
            self._message, self._counting = self._counting.result(), None


def _free_place(folder: Path) -> Path:
    taken = (
        [int(p.name[5:]) for p in folder.glob("pose_*") if p.name[5:].isdigit()] if folder.is_dir() else []
    )
    return folder / f"pose_{max(taken, default=-1) + 1:02d}"


def _settings_text(settings: CameraSettings) -> str:
    return f"exposure {1e3 * settings.exposure_s:.4g} ms, gain {settings.gain_db:.3g} dB"
