"""`fpplab live`: set a rig up while watching what it sees."""

from __future__ import annotations

import sys
import time
from contextlib import ExitStack
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fpplab.cli import console
from fpplab.cli.app import PREPARE, Force, Json, RigName, app
from fpplab.cli.completion import names_of
from fpplab.core.errors import ConfigError
from fpplab.core.extras import how_to_install, need_extra

if TYPE_CHECKING:
    from fpplab.core.conventions import Mask
    from fpplab.devices import Frame
    from fpplab.devices.rig import Rig
    from fpplab.patterns.fringes import Pattern
    from fpplab.patterns.plan import Plan
    from fpplab.setup.live.expectation import WorkingPoint
    from fpplab.setup.live.page import SetUpPage
    from fpplab.setup.live.status import LiveStatus
    from fpplab.viewer.live import LiveView
    from fpplab.viewer.viewer import Viewer

LINE_S = 0.25
"""Time in s between two status lines on a terminal."""


@app.command("live", rich_help_panel=PREPARE)
def live_command(
    rig: RigName,
    plan: Annotated[
        str | None,
        typer.Option(
            "--plan",
            help="Plan that will be measured with; by default plan_board.yaml with --target, else "
            "plan_paper.yaml.",
            autocompletion=names_of("plan"),
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", help="Show overlap, angle and expected uncertainty, by this one."),
    ] = None,
    distance: Annotated[
        float | None,
        typer.Option(
            "--distance",
            min=1.0,
            help="Distance of the part from the camera in mm; by default the middle of `depth_mm` of plan or "
            "rig, or else where both middle rays meet.",
        ),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            "--target",
            help="The board, to take poses of it for `characterise`.",
            autocompletion=names_of("target"),
        ),
    ] = None,
    poses: Annotated[
        Path, typer.Option("--poses", help="Folder of the sessions of poses that are taken.")
    ] = Path("live_poses"),
    item: Annotated[
        str | None, typer.Option("--item", help="Have the rig's fixture put this up first.")
    ] = None,
    stage_step: Annotated[
        float, typer.Option("--stage-step", min=1e-4, help="How far one key moves the stage, in mm.")
    ] = 1.0,
    frames: Annotated[int | None, typer.Option("--frames", min=1, help="End after so many frames.")] = None,
    seconds: Annotated[
        float | None, typer.Option("--seconds", min=0.1, help="End after so many seconds.")
    ] = None,
    view: Annotated[
        bool, typer.Option("--view/--no-view", help="Show images in the viewer, or only figures here.")
    ] = True,
    out: Annotated[
        Path | None, typer.Option("--out", help="Leave a recording of what the viewer shows, as .rrd.")
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Set a rig up: see focus, exposure, overlap and coverage at the camera's rate.

    Driven by keys here or by the buttons of a page for the browser, whose address is printed. Any other
    fpplab command that wants the rig gets it at once: `live` closes the devices and goes on afterwards.
    Quitting leaves the projector dark.

    Keys: `a` takes the advised exposure, `+` `-` exposure, `>` `<` gain; `m` measures with fringes, `w`
    white, `b` black, `c` `f` coarse and fine fringes, `k` checkerboard, `x` cross; `[` `]` stage, `h` homes
    it; `t` takes a pose, `n` next pose of the fixture; `r` forgets the best focus; `q` quits.

    Example: `fpplab live --rig rig_demo --item board --target target_paper --poses poses`
    """
    from fpplab.core.files import need_suffix, refuse_existing
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan

    name = plan or ("plan_board.yaml" if target else "plan_paper.yaml")
    wanted, bench = Plan.load(name), Rig.load(rig)
    if target:
        _need_board_plan(wanted, name)
    if item:
        _need_fixture(bench, item)
    if out:
        need_suffix(out, ".rrd")
        refuse_existing(out, force)
        need_extra("rerun")
    working = _working_point(bench, wanted, name, calibration, distance)

    from queue import SimpleQueue

    from fpplab.devices.rig_lock import watching_rig
    from fpplab.setup.live.keys import terminal_keys
    from fpplab.setup.live.loop import LiveOptions, SetUp
    from fpplab.setup.live.orders import Order
    from fpplab.setup.live.page import SetUpPage
    from fpplab.targets import Target

    options = LiveOptions(
        plan=wanted,
        working=working,
        target=Target.load(target) if target else None,
        poses=poses,
        item=item,
        stage_step_mm=stage_step,
        frames=frames,
        seconds=seconds,
    )
    orders: SimpleQueue[Order] = SimpleQueue()
    with ExitStack() as stack:
        turn = stack.enter_context(watching_rig(bench.source))
        shown = _viewer(stack, view, out, working)
        page = stack.enter_context(SetUpPage(orders, _page_of(shown)))
        keys = stack.enter_context(terminal_keys(orders))
        console.log_status(f"Buttons{' and images' if _page_of(shown) else ''}: {page.address}")
        if keys:
            console.log_status(
                "Keys: a advice, + - exposure, m measure, w white, t take, q quit; all by --help"
            )
        run = SetUp(bench, options, orders, _Observer(page, shown, recorded=out is not None))
        last = run.run(turn)
        _clear_line()
    result = {**last.summary(), "poses": [str(path) for path in run.poses], "out": str(out) if out else None}
    console.print_result(result, json, lambda: _show_result(result))


def _page_of(viewer: Viewer[LiveView]) -> str | None:
    return viewer.where if viewer.where.startswith("http") else None


def _need_board_plan(plan: Plan, name: str) -> None:
    from fpplab.phase import check_unwrapping

    check_unwrapping(plan, name)
    if plan.axes != ("x", "y"):
        raise ConfigError(f"{name}: has fringes along {plan.axes[0]} alone; poses of a board need x and y")


def _need_fixture(bench: Rig, item: str) -> None:
    if bench.file.fixture is None:
        raise ConfigError(f"{bench.source}: 'fixture' is missing, and --item {item} needs one")


def _working_point(
    bench: Rig, plan: Plan, name: str, path: Path | None, distance_mm: float | None
) -> WorkingPoint | None:
    """What the geometry promises, where it is known."""
    if path is None:
        if distance_mm is not None:
            raise ConfigError("--distance is of use with --calibration only; give it too, or leave it out")
        return None
    from fpplab.calibration.model import Calibration
    from fpplab.reconstruction.depth_range import first_stated
    from fpplab.setup.live.expectation import RigGeometry, WorkingPoint

    stated = first_stated((plan.depth_mm, name), (bench.file.depth_mm, bench.source))
    geometry = RigGeometry(Calibration.load(path), stated)
    middle = sum(stated.mm) / 2 if stated else None
    return WorkingPoint(geometry, plan, distance_mm or middle or geometry.meeting_mm)


def _viewer(
    stack: ExitStack, wanted: bool, out: Path | None, working: WorkingPoint | None
) -> Viewer[LiveView]:
    """The viewer, once it is open; its page is part of the set-up's. Without rerun it shows nothing."""
    if wanted and find_spec("rerun") is None:
        console.log_status(f"Without images: {how_to_install('rerun')}")
        wanted = False
    from fpplab.viewer.live import MOST_WAITING, LiveView
    from fpplab.viewer.viewer import Viewer

    viewer = Viewer(LiveView, "anywhere" if wanted else None, out, most_waiting=MOST_WAITING)
    stack.enter_context(viewer)
    viewer.wait_open()
    if working:
        viewer.show(LiveView.scene, working.geometry, working.distance_mm)
    return viewer


class _Observer:
    """Shows the set-up on the page, in the viewer and in one line of the terminal."""

    def __init__(self, page: SetUpPage, viewer: Viewer[LiveView], recorded: bool) -> None:
        from fpplab.viewer.live import LiveFrames

        self._page, self._viewer, self._recorded = page, viewer, recorded
        self._frames = LiveFrames(viewer)
        self._said, self._line_s = "", 0.0

    def __call__(
        self, status: LiveStatus, frame: Frame | None, pattern: Pattern | None, dark: Mask | None
    ) -> bool:
        self._page.show(status)
        # No backlog for who opens the page later.
        looked_at = self._page.seen or self._recorded or _page_of(self._viewer) is None
        if self._viewer.runs and frame is not None and pattern is not None and looked_at:
            self._frames.show(status, frame, pattern, dark)
        self._say(status)
        return not (self._page.closed or self._viewer.window_closed)

    def _say(self, status: LiveStatus) -> None:
        said = f"paused: {status.paused_for} has the rig" if status.paused_for else status.message
        if said != self._said:
            self._said = said
            if said:
                _clear_line()
                console.log_status(said)
        if console.stderr.is_terminal and time.monotonic() - self._line_s > LINE_S:
            self._line_s = time.monotonic()
            width = console.stderr.width - 1
            sys.stderr.write(f"\r{status.line()[:width]:<{width}}")
            sys.stderr.flush()


def _clear_line() -> None:
    if console.stderr.is_terminal:
        sys.stderr.write("\r\x1b[K")
        sys.stderr.flush()


def _show_result(result: dict[str, Any]) -> None:
    chosen = f"exposure_s: {result['exposure_s']:.6g}" if result["exposure_s"] else "no frame was taken"
    console.stdout.print(f"{chosen}  (for the plan)", markup=False)
    if result["gain_db"] is not None:
        console.stdout.print(f"gain_db: {result['gain_db']:.3g}  (for the rig file's camera)", markup=False)
    console.stdout.print(f"frames: {result['frames']}", markup=False)
    for pose in result["poses"]:
        console.stdout.print(f"pose: {pose}", markup=False)
    for limit in (result["advice"] or {}).get("limits", []):
        console.stdout.print(limit, markup=False)
