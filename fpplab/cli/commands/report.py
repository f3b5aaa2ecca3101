"""`fpplab report`: several scans on one page."""

from pathlib import Path
from typing import Annotated, Any

import typer

from fpplab.cli import console
from fpplab.cli.app import Force, Json, app
from fpplab.cli.completion import existing_data, option
from fpplab.cli.viewing import ConsoleObserver


@app.command("report", rich_help_panel="data")
def report_command(
    scans: Annotated[
        list[Path], typer.Argument(help="Two or more sessions or clouds.", callback=existing_data)
    ],
    out: Annotated[Path, option("--out", "HTML file to write.")],
    force: Force = False,
    json: Json = False,
) -> None:
    """Compare several scans on one page: verdicts, figures side by side, and differences between their plans.

    For scans reconstructed with the same calibration, the page also shows how far each is from the first,
    pixel by pixel along the camera rays.

    Example: `fpplab report monday tuesday wednesday/cloud.ply --out week.html`
    """
    from fpplab.workflows.report import ScansRequest, run_scans_report

    answer = run_scans_report(ScansRequest(tuple(scans), out, force), ConsoleObserver()).summary()
    console.print_result(answer, json, lambda: _show(answer))


def _show(answer: dict[str, Any]) -> None:
    rows = [
        [entry[key] or "–" for key in ("name", "verdict", "points", "noise_um")] for entry in answer["scans"]
    ]
    console.table("Scans", ["scan", "verdict", "points", "noise µm"], rows)
    if plans := answer["plans"]:
        columns = ["what the plans differ by", *next(iter(plans.values()))]
        console.table("Plans", columns, [[name, *values.values()] for name, values in plans.items()])
    for entry in answer["differences"]:
        figures = (
            entry.get("not_compared") or f"{entry['rms_um']:.1f} µm RMS, median {entry['median_um']:+.1f} µm"
        )
        console.stdout.print(f"{entry['scan']} minus {entry['reference']}: {figures}")
    console.stdout.print(f"report: {answer['report']}")
