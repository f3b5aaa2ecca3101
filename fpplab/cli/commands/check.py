"""`fpplab check`: find out what is wrong with a rig."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from fpplab.cli import console
from fpplab.cli.app import PREPARE, Force, Json, ReportOption, RigName, app
from fpplab.cli.completion import config_option, option
from fpplab.cli.viewing import ConsoleObserver
from fpplab.core.errors import ConfigError, DeviceError

if TYPE_CHECKING:
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.setup.rig_check.check import RigCheck
    from fpplab.workflows.check import BoardCheckRequest


@app.command("check", rich_help_panel=PREPARE)
def check_command(
    rig: RigName,
    plan: Annotated[
        str | None,
        config_option("plan", "Plan to project and capture. Default: plan_scan; with --board, plan_board."),
    ] = None,
    item: Annotated[
        str | None,
        option(
            "--item",
            "Item in view: an evenly white card or a bright part. Default: grey_card; with --board, board.",
        ),
    ] = None,
    calibration: Annotated[
        Path | None, option("--calibration", "Calibration to check against the present geometry of the rig.")
    ] = None,
    out: Annotated[
        Path | None,
        option("--out", "Folder for one picture per finding; a .png file for a plot of the grey levels."),
    ] = None,
    page: ReportOption = None,
    steps: Annotated[
        bool,
        option(
            "--steps", "Test connection, light, triggers, frame rate, exposure and focus one after another."
        ),
    ] = False,
    board: Annotated[
        Path | None,
        option("--board", "Record one pose of the board in this folder and check --calibration with it."),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Test a rig, and say what is wrong with it.

    Tests whether each frame shows its own pattern. Projects twelve uniform grey levels, stepped and, if
    camera and projector support it, triggered, with the exposure and settling time of the plan; reports the
    settling time that the display needs. Then projects the fringes of the plan and reports problems of light,
    focus, response and motion. With --calibration it projects fringes along both axes and tests whether the
    calibration still fits the rig. With --steps it tests one thing after another, for the first day with a
    rig, and stops where it cannot continue. The exit code is 0 without findings and 3 with findings. --out
    saves a picture of each finding: the frame, map or curve that shows it.

    With --board nothing else is tested: one pose of the board is compared with the calibration. If they
    agree, the date is recorded in the calibration; if not, the exit code is 3 and the folder contains a
    corrected one.

    Example: `fpplab check --rig rig_demo --plan plan_scan --calibration calibration.yaml`
    """
    from fpplab.calibration.model import Calibration
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.workflows.check import BoardCheckRequest, CheckRequest, run_check

    if board:
        if steps or out or page or calibration is None:
            raise ConfigError("--board: goes with --calibration, and without --steps, --out and --report")
        of_board = Plan.load(plan or "plan_board")
        _check_board(
            BoardCheckRequest(Rig.load(rig), of_board, calibration, board, item or "board", force), json
        )
        return
    item, loaded = item or "grey_card", Plan.load(plan or "plan_scan.yaml")
    if steps:
        if calibration or out or page:
            raise ConfigError("--steps: goes without --calibration, --out and --report; leave them out")
        _check_steps(Rig.load(rig), loaded, item, json)
        return
    request = CheckRequest(
        rig=Rig.load(rig),
        plan=loaded,
        item=item,
        calibration=Calibration.load(calibration) if calibration else None,
        pictures=out,
        page=page,
        force=force,
        calibration_file=calibration,
    )
    result = run_check(request, ConsoleObserver())
    console.print_result(result.summary(), json, lambda: _show_check(result.check))
    if result.check.findings:
        raise console.CommandExit(DeviceError.exit_code)


def _check_board(request: BoardCheckRequest, json: bool) -> None:
    from fpplab.workflows.check import run_board_check

    result = run_board_check(request, ConsoleObserver())

    def show() -> None:
        console.stdout.print(result.judged.judgement.verdict)
        if (new := result.corrected) is not None:
            changes = new.correction.probabilities.items()
            said = ", ".join(f"{name} ({100 * chance:.0f} %)" for name, chance in changes if chance > 0.05)
            console.stdout.print(f"probably {said}; scan with {new.calibration_file}")

    console.print_result(result.summary(), json, show)
    if result.corrected is not None:
        raise console.CommandExit(DeviceError.exit_code)


def _check_steps(rig: Rig, plan: Plan, item: str, json: bool) -> None:
    from fpplab.setup.rig_check.steps import CheckedStep, check_steps

    def tell(step: CheckedStep) -> None:
        if not json:
            console.stdout.print(f"{step.name}: {'ok' if step.ok else 'FAILS'}: {step.seen}")
            if step.remedy:
                console.stdout.print(f"  {step.remedy}")

    with console.progress("Checking") as report:
        checked = check_steps(rig, plan, item, report, tell)
    ok = all(step.ok for step in checked)
    console.print_result({"ok": ok, "steps": [asdict(step) for step in checked]}, json, lambda: None)
    if not ok:
        raise console.CommandExit(DeviceError.exit_code)


def _show_check(check: RigCheck) -> None:
    for run in check.runs:
        console.log_status(
            f"{run.how}: {len(run.levels)} greys, white brighter by {100 * run.rise:.2g} % of full scale"
        )
    if (timing := check.timing) is not None:
        console.log_status(
            f"each pattern is shown for {1e3 * timing.light_s:.6g} ms, the next one follows "
            f"{1e3 * timing.period_s:.6g} ms after it began: by {timing.limit}"
        )
    for finding in check.findings:
        console.stdout.print(f"{finding.sentence}; {finding.remedy}")
    for unknown in check.unknown:
        console.log_status(f"not checked: {unknown}")
    if not check.findings:
        console.stdout.print("ok")
