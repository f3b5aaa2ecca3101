"""`fpplab live`: set a rig up while watching what it sees."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from fpplab.cli import console
from fpplab.cli.app import PREPARE, Force, Json, RigName, app
from fpplab.cli.completion import config_option, option

if TYPE_CHECKING:
    from fpplab.setup.live.status import LiveStatus

LINE_INTERVAL_S = 0.25  # time in s between two updates of the status line (chosen)


@app.command("live", rich_help_panel=PREPARE)
def live_command(
    rig: RigName,
    plan: Annotated[
        str | None,
        config_option(
            "plan",
            "Plan to prepare for. Default: plan_board with --target, otherwise plan_scan.",
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        option("--calibration", "Calibration used to show overlap, angle and expected uncertainty."),
    ] = None,
    distance: Annotated[
        float | None,
        option(
            "--distance",
            "Distance of the part from the camera in mm. Default: the middle of `depth_mm` of plan or "
            "rig, otherwise where the optical axes are closest.",
            min=1.0,
        ),
    ] = None,
    target: Annotated[
        str | None,
        config_option("target", "Target file of the board, to record its poses for `characterise`."),
    ] = None,
    poses: Annotated[Path, option("--poses", "Folder in which recorded poses are saved.")] = Path(
        "live_poses"
    ),
    item: Annotated[str | None, option("--item", "Item to mount first.")] = None,
    stage_step: Annotated[
        float, option("--stage-step", "Distance in mm that one key press moves the stage.", min=1e-4)
    ] = 1.0,
    frames: Annotated[int | None, option("--frames", "Stop after this number of frames.", min=1)] = None,
    seconds: Annotated[float | None, option("--seconds", "Stop after this time in s.", min=0.1)] = None,
    view: Annotated[
        bool, option("--view/--no-view", "Show images in the viewer, or figures in the terminal only.")
    ] = True,
    out: Annotated[Path | None, option("--out", "Save what the viewer shows as an .rrd file.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Set up a rig live: focus, exposure, overlap and coverage.

    All figures are updated at the camera's frame rate. Use the keys in the terminal or the buttons of a
    browser page whose address is printed. Other fpplab commands that need the rig get it at once: `live`
    closes the devices and continues afterwards. Quitting leaves the projector dark.

    Keys: `a` sets the recommended exposure, `+` `-` change exposure, `>` `<` gain; `m` measures with
    fringes, `w` shows white, `b` black, `c` `f` coarse and fine fringes, `k` a checkerboard, `x` a cross;
    `[` `]` move the stage, `h` homes it; `t` records a pose, `n` mounts the next pose; `r` resets the best
    focus; `q` quits.

    Example: `fpplab live --rig rig_demo --item board --target target_paper --poses poses`
    """
    from fpplab.workflows.live import LiveRequest, run_live

    request = LiveRequest(
        rig=rig,
        plan=plan,
        calibration=calibration,
        distance_mm=distance,
        target=target,
        poses=poses,
        item=item,
        stage_step_mm=stage_step,
        frames=frames,
        seconds=seconds,
        view=view,
        recording=out,
        force=force,
    )
    try:
        result = run_live(request, console.log_status, _StatusLine())
    finally:
        _clear_line()
    summary = result.summary()
    console.print_result(summary, json, lambda: _print_summary(summary))


class _StatusLine:
    """New messages as lines, and the present state as one line that is overwritten."""

    def __init__(self) -> None:
        self._message, self._written_s = "", 0.0

    def __call__(self, status: LiveStatus) -> None:
        message = f"paused: {status.paused_for} has the rig" if status.paused_for else status.message
        if message != self._message:
            self._message = message
            if message:
                _clear_line()
                console.log_status(message)
        if console.stderr.is_terminal and time.monotonic() - self._written_s > LINE_INTERVAL_S:
            self._written_s = time.monotonic()
            width = console.stderr.width - 1
            sys.stderr.write(f"\r{status.line()[:width]:<{width}}")
            sys.stderr.flush()


def _clear_line() -> None:
    if console.stderr.is_terminal:
        sys.stderr.write(f"\r{'':{console.stderr.width - 1}}\r")  # consoles of Windows may know no codes
        sys.stderr.flush()


def _print_summary(summary: dict[str, Any]) -> None:
    chosen = f"exposure_s: {summary['exposure_s']:.6g}" if summary["exposure_s"] else "no frame was taken"
    console.stdout.print(f"{chosen}  (for the plan)")
    if summary["gain_db"] is not None:
        console.stdout.print(f"gain_db: {summary['gain_db']:.3g}  (for the rig file's camera)")
    console.stdout.print(f"frames: {summary['frames']}")
    for pose in summary["poses"]:
        console.stdout.print(f"pose: {pose}")
    for limit in (summary["advice"] or {}).get("limits", []):
        console.stdout.print(limit)
