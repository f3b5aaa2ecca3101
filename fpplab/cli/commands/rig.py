"""`fpplab rig`: write a rig file from what is connected, and measure a projector's times."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import PREPARE, Commands, Force, Json, Out, PlanName, RigName, app
from fpplab.cli.completion import option
from fpplab.core.errors import ConfigError, DeviceError
from fpplab.core.files import check_new_file, write_text

if TYPE_CHECKING:
    from fpplab.setup.display_timing import DisplayTiming

rig_app = typer.Typer(
    cls=Commands,
    help="Write a rig file for connected devices; measure timing.",
    no_args_is_help=True,
)
app.add_typer(rig_app, name="rig", rich_help_panel=PREPARE)

NAMED = "Serial number, model, port or display, as `fpplab devices` shows it"


@rig_app.command("new")
def new_command(
    out: Out,
    name: Annotated[str, option("--name", "Name of the rig in reports.")] = "Bench",
    camera: Annotated[str | None, option("--camera", f"{NAMED}.")] = None,
    projector: Annotated[str | None, option("--projector", f"{NAMED}.")] = None,
    stage: Annotated[str | None, option("--stage", f"{NAMED}; `none` for none.")] = None,
    home: Annotated[bool, option("--home", "Home the stage. Its carriage moves.")] = False,
    operator: Annotated[
        bool, option("--operator/--no-operator", "Whether a person mounts the items to be measured.")
    ] = True,
    no_questions: Annotated[
        bool, option("--no-questions", "Do not ask: use the devices named, or the only one of its kind.")
    ] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Choose among the connected devices, test each, and write a rig file.

    The camera must deliver an image and see the projector's white brighter than its black; the stage must
    answer, and is homed if you agree. The file is written only if all devices pass. With --no-questions a
    serial port or the computer's main display is only used if it is named.

    Example: `fpplab rig new --out rig.yaml`
    """
    from fpplab.devices.discovery import connected_devices
    from fpplab.setup.new_rig import RigSetup

    check_new_file(out, force, ".yaml")
    if not no_questions and not _has_terminal():
        raise ConfigError(
            "there is nobody at the terminal to be asked; add --no-questions and name the devices"
        )
    devices = connected_devices()
    named = {"camera": camera, "projector": projector, "stage": stage}
    names = {kind: value for kind, value in named.items() if value is not None}
    setup = RigSetup(
        devices, names, out.absolute().parent, None if no_questions else _ask, console.log_status
    )
    draft = setup.choose_and_test_devices(home, operator)
    write_text(out, draft.text(name))
    console.print_result(
        {"rig": str(out), **draft.summary()},
        json,
        lambda: console.stdout.print(f"{out}; next: `fpplab check --rig {out}`"),
    )


@rig_app.command("timing")
def timing_command(rig: RigName, plan: PlanName = "plan_scan.yaml", json: Json = False) -> None:
    """Measure with the camera the delay with which the projector shows a pattern, and its refresh time.

    Needs a white card or a bright part in the light. Reports the `settle_s` that a stepped plan needs. The
    exit code is 3 if the refresh rate seen by the camera is not the one that the display reports.

    Example: `fpplab rig timing --rig rig.yaml`
    """
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.setup.display_timing import measure_display

    loaded_plan = Plan.load(plan)
    with Rig.load(rig) as bench, console.progress("Timing") as report:
        timing = measure_display(bench, loaded_plan, report)
    console.print_result(timing.summary(), json, lambda: _show_timing(timing))
    if not timing.agrees:
        raise console.CommandExit(DeviceError.exit_code)


def _show_timing(timing: DisplayTiming) -> None:
    print_line = console.stdout.print
    settle_s = timing.settle_s
    print_line(f"latency: {1e3 * settle_s:.0f} ms; put `settle_s: {settle_s:.3g}` or more into the plan")
    if timing.refresh_s is not None and timing.reported_s is not None:
        measured_ms, reported_ms = 1e3 * timing.refresh_s, 1e3 * timing.reported_s
        print_line(
            f"refresh: {measured_ms:.2f} ms as the camera sees it, {reported_ms:.2f} ms as the display "
            "reports it"
        )
    if not timing.agrees:
        print_line(
            "they differ: something between computer and projector converts the rate; set both to one rate"
        )


def _has_terminal() -> bool:
    return sys.stdin.isatty()


def _ask(question: str, answers: Sequence[str]) -> int:
    console.log_status(question)
    for k, answer in enumerate(answers, 1):
        console.log_status(f"  {k}  {answer}")
    chosen: int = typer.prompt("number", type=int, err=True)
    while not 1 <= chosen <= len(answers):
        chosen = typer.prompt(f"number from 1 to {len(answers)}", type=int, err=True)
    return chosen - 1
