"""`fpplab demo`: a complete measurement on the virtual bench."""

from pathlib import Path
from typing import Annotated, Any

from fpplab.cli import console
from fpplab.cli.app import START, Force, Json, Out, app
from fpplab.cli.completion import option
from fpplab.cli.viewing import ConsoleObserver


@app.command("demo", rich_help_panel=START)
def demo_command(
    out: Out = Path("fpplab-demo"),
    quick: Annotated[bool, option("--quick", "Use 684 x 456 pixels instead of 1368 x 912.")] = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Measure three artefacts on the virtual bench, with a report.

    Shows the whole method: response, characterisation with a circle board, scans of a pyramid, pillars and
    steps, and their comparison with the true shapes. Open the report whose path is printed.

    Example: `fpplab demo --quick --out first-look`
    """
    from fpplab.workflows.demo import DemoRequest, run_demo

    result = run_demo(DemoRequest(out, quick, force), ConsoleObserver()).summary()
    console.print_result(result, json, lambda: _show_demo(result))


def _show_demo(result: dict[str, Any]) -> None:
    scans = [[s[k] for k in DEMO_COLUMNS] for s in result["scans"]]
    console.table("Scans", list(DEMO_COLUMNS.values()), scans)
    rms = result["characterisation"]
    console.stdout.print(
        f"camera {rms['camera']['rms_px']:.3f} px, projector {rms['projector']['rms_px']:.3f} px, "
        f"mean surface SMCD {result['mean_surface_smcd_um']:.1f} µm, {result['seconds']:.0f} s"
    )
    console.stdout.print(f"report: {result['report']}")


DEMO_COLUMNS = {
    "artefact": "artefact",
    "images": "images",
    "points": "points",
    "verdict": "verdict",
    "surface_smcd_um": "surface SMCD µm",
    "surface_rms_um": "RMS µm",
    "completeness": "complete",
}
