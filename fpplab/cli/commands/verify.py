"""`fpplab verify`: acceptance test of a measuring system."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import JUDGE, Force, Json, Out, PlanName, app
from fpplab.cli.completion import config_option, option
from fpplab.cli.lists import VariadicOptionsCommand
from fpplab.cli.viewing import AcceptanceObserver, KeepOpen, ViewOption, make_observer

if TYPE_CHECKING:
    from fpplab.comparison.acceptance import Acceptance


@app.command("verify", cls=VariadicOptionsCommand, rich_help_panel=JUDGE)
def verify_command(
    context: typer.Context,
    standard: Annotated[
        str, config_option("standard", "Standard file: ball bar, plane and permissible errors.")
    ],
    out: Out,
    spheres: Annotated[
        list[Path] | None, option("--spheres", "Clouds or sessions of the ball bar; any number.")
    ] = None,
    planes: Annotated[
        list[Path] | None, option("--planes", "Clouds or sessions of the plane; any number.")
    ] = None,
    mpe: Annotated[str, option("--mpe", "Maximum permissible errors in µm, such as PF=50,SD=30.")] = "",
    positions: Annotated[
        str,
        option(
            "--positions",
            "Minimum numbers of positions, such as PF=10,SD=7. Default: the standard file's, or "
            "PF=10,PS=10,SD=7,F=6.",
        ),
    ] = "",
    rig: Annotated[
        str | None, config_option("rig", "Measure the items of the standard now with this rig.")
    ] = None,
    calibration: Annotated[
        Path | None, option("--calibration", "Calibration of the rig, or for sessions without a cloud.")
    ] = None,
    plan: PlanName = "plan_scan.yaml",
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Acceptance test based on VDI/VDE 2634 part 2.

    It needs a ball bar and a plane. Probing error of form PF and of size PS, sphere-spacing error SD and
    flatness measurement error F, each in µm with its maximum permissible error. PF and F are the range of the
    points without the 0.3 % farthest from the fit; PF_all and F_all, also given, the range of all points. The
    angle of incidence up to which points of a sphere count, 60° by default, is part of the result. `verdict`
    says whether the system can be trusted, `findings` why not. A failed test is a result, not an error: the
    exit code is 0 and `passed` is false; if an error is ten times the permissible one the exit code is 4.
    Writes OUT, a report.

    Examples: `fpplab verify --standard standard_demo --spheres bar1/cloud.ply bar2/cloud.ply
    --planes plane1/cloud.ply --out verify.html`;
    `fpplab verify --standard standard_demo --rig rig_demo --calibration calibration.yaml --out verify.html`
    """
    from fpplab.calibration.model import Calibration
    from fpplab.comparison.acceptance import Standard
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.workflows.verify import AcceptanceRequest, check_acceptance_input, run_acceptance

    loaded_standard = Standard.load(standard).with_mpe(_listed(mpe)).with_positions(_listed(positions))
    request = AcceptanceRequest(
        standard=loaded_standard,
        out=out,
        spheres=tuple(spheres or ()),
        planes=tuple(planes or ()),
        calibration=Calibration.load(calibration) if calibration else None,
        rig=Rig.load(rig) if rig else None,
        plan=Plan.load(plan) if rig else None,
        force=force,
        calibration_file=calibration,
    )
    check_acceptance_input(request)
    observer = make_observer(context, AcceptanceObserver, view, keep_open, out.with_suffix(".rrd"))
    result = run_acceptance(request, observer)
    acceptance = result.acceptance
    console.print_verdict_and_result(
        result.diagnosis, str(out), result.summary(), json, lambda: _show(acceptance, out)
    )


def _listed(option: str) -> list[str]:
    return [word for word in option.split(",") if word.strip()]


def _show(result: Acceptance, out: Path) -> None:
    from fpplab.comparison.acceptance import VERDICTS

    rows = [
        [
            name,
            f"{judgement.positions} of {judgement.min_positions}",
            judgement.worst_um,
            "–" if judgement.worst_all_um is None else judgement.worst_all_um,
            judgement.mpe_um or "–",
            VERDICTS[judgement.passed],
        ]
        for name, judgement in result.judgements().items()
    ]
    heads = ["", "values", "worst µm", "of all points", "permitted µm", ""]
    console.table(f"Acceptance test: {result.standard.name}", heads, rows)
    console.stdout.print(f"spheres up to {result.standard.evaluation.cap_deg:g}° of incidence")
    console.stdout.print(f"{VERDICTS[result.passed]}; report: {out}")
