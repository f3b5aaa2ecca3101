"""Set a rig up while watching what it sees."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Mask
from fpplab.core.depth import first_stated
from fpplab.core.errors import ConfigError
from fpplab.core.extras import how_to_install, need_extra
from fpplab.core.files import check_new_file
from fpplab.core.progress import ignore
from fpplab.devices import Frame
from fpplab.devices.rig import Rig
from fpplab.devices.rig_lock import watching_rig
from fpplab.patterns.fringes import Pattern
from fpplab.patterns.plan import Plan
from fpplab.phase import check_unwrapping
from fpplab.setup.live.expectation import RigGeometry, WorkingPoint
from fpplab.setup.live.keys import terminal_keys
from fpplab.setup.live.loop import LiveOptions, LiveSetUp
from fpplab.setup.live.orders import Order
from fpplab.setup.live.page import SetUpPage
from fpplab.setup.live.status import LiveStatus
from fpplab.targets import Target
from fpplab.viewer.live import LiveFrames, LiveView
from fpplab.viewer.server import ViewerPlace
from fpplab.viewer.viewer import Viewer


@dataclass(frozen=True)
class LiveRequest:
    """What `run_live` is to show."""

    rig: str  # rig file, or name of one that is delivered
    plan: str | None = None  # by default `plan_board.yaml` with a target, else `plan_scan.yaml`
    calibration: Path | None = None  # by which overlap, angle and expected uncertainty are shown
    # Distance of the part from the camera; by default the middle of `depth_mm` of plan or rig, or else where
    # both middle rays meet.
    distance_mm: float | None = None
    target: str | None = None  # the board, to take poses of it
    poses: Path = Path("live_poses")  # folder of the sessions of poses that are taken
    item: str | None = None  # that the rig's fixture mounts first
    stage_step_mm: float = 1.0  # how far one key moves the stage
    frames: int | None = None  # when to end; None: when the operator ends it
    seconds: float | None = None
    view: bool = True  # whether images are shown in the viewer
    recording: Path | None = None  # .rrd of what the viewer shows
    force: bool = False  # whether the recording replaces an existing file


@dataclass(frozen=True, eq=False)
class LiveResult:
    """What was set when the operator ended it."""

    status: LiveStatus  # the last snapshot
    poses: tuple[Path, ...]  # sessions of the poses in which the board was found
    recording: Path | None  # of what the viewer showed

    def summary(self) -> dict[str, Any]:
        return {
            **self.status.summary(),
            "poses": [str(path) for path in self.poses],
            "out": str(self.recording) if self.recording else None,
        }


def run_live(
    request: LiveRequest,
    log: Callable[[str], object] = ignore,
    show_status: Callable[[LiveStatus], object] = ignore,
) -> LiveResult:
    """Show what a rig sees until the operator ends it."""
    rig, options = _check_request(request)
    orders: SimpleQueue[Order] = SimpleQueue()
    with ExitStack() as stack:
        turn = stack.enter_context(watching_rig(rig.source))
        viewer = stack.enter_context(_viewer(request, log))
        viewer.wait_open()
        if options.working:
            viewer.show(LiveView.scene, options.working.geometry, options.working.distance_mm)
        page = stack.enter_context(SetUpPage(orders, _page_of(viewer)))
        has_keys = stack.enter_context(terminal_keys(orders))
        log(f"Buttons{' and images' if _page_of(viewer) else ''}: {page.address}")
        if has_keys:
            log("Keys: a advice, + - exposure, m measure, w white, t take, q quit; all by --help")
        observer = _Observer(page, viewer, request.recording is not None, show_status)
        setup = LiveSetUp(rig, options, orders, observer)
        last = setup.run(turn)
    return LiveResult(last, setup.poses, request.recording)


def _check_request(request: LiveRequest) -> tuple[Rig, LiveOptions]:
    """Check the request before any device is opened."""
    name = request.plan or ("plan_board.yaml" if request.target else "plan_scan.yaml")
    plan, rig = Plan.load(name), Rig.load(request.rig)
    if request.target:
        check_unwrapping(plan, name)
        if plan.unwrapped_axes != ("x", "y"):
            raise ConfigError(
                f"{name}: has fringes along {plan.unwrapped_axes[0]} alone; poses of a board need x and y"
            )
    if request.item and rig.file.fixture is None:
        raise ConfigError(f"{rig.source}: 'fixture' is missing, and --item {request.item} needs one")
    if request.recording:
        check_new_file(request.recording, request.force, ".rrd")
        need_extra("rerun")
    options = LiveOptions(
        plan=plan,
        working=_working_point(rig, plan, name, request),
        target=Target.load(request.target) if request.target else None,
        poses=request.poses,
        item=request.item,
        stage_step_mm=request.stage_step_mm,
        frames=request.frames,
        seconds=request.seconds,
    )
    return rig, options


def _working_point(rig: Rig, plan: Plan, name: str, request: LiveRequest) -> WorkingPoint | None:
    if request.calibration is None:
        if request.distance_mm is not None:
            raise ConfigError("--distance has an effect with --calibration only; give both or neither")
        return None
    stated = first_stated((plan.depth_mm, name), (rig.file.depth_mm, rig.source))
    geometry = RigGeometry(Calibration.load(request.calibration), stated)
    middle_mm = sum(stated.mm) / 2 if stated else None
    return WorkingPoint(geometry, plan, request.distance_mm or middle_mm or geometry.meeting_mm)


def _viewer(request: LiveRequest, log: Callable[[str], object]) -> Viewer[LiveView]:
    """The viewer, whose page is part of the set-up's page; without rerun it shows nothing."""
    shown: ViewerPlace | None = "anywhere" if request.view else None
    if shown and find_spec("rerun") is None:
        log(f"Without images: {how_to_install('rerun')}")
        shown = None
    # Recent frames matter more than all of them.
    return Viewer(LiveView, shown, request.recording, max_queued=3)


def _page_of(viewer: Viewer[LiveView]) -> str | None:
    return viewer.where if viewer.where.startswith("http") else None


class _Observer:
    """Shows the set-up on its page and in the viewer, and passes the status on."""

    def __init__(
        self,
        page: SetUpPage,
        viewer: Viewer[LiveView],
        is_recorded: bool,
        show_status: Callable[[LiveStatus], object],
    ) -> None:
        self._page, self._viewer, self._show_status = page, viewer, show_status
        self._is_recorded = is_recorded
        self._frames = LiveFrames(viewer)

    def __call__(
        self, status: LiveStatus, frame: Frame | None, pattern: Pattern | None, dark: Mask | None
    ) -> bool:
        self._page.show(status)
        # Nothing is sent before the page has been opened: it would first show a backlog.
        has_spectator = self._page.is_opened or self._is_recorded or _page_of(self._viewer) is None
        if self._viewer.runs and frame is not None and pattern is not None and has_spectator:
            self._frames.show(status, frame, pattern, dark)
        self._show_status(status)
        return not (self._page.closed or self._viewer.window_closed)
