"""`fpplab compare-rigs`: a bench and its twin on one scan."""

from pathlib import Path
from typing import Annotated, Any

import typer

from fpplab.cli import console
from fpplab.cli.app import Json
from fpplab.cli.completion import config_option, existing_data, existing_file, option

program = typer.Typer()


@program.command("compare-rigs", rich_help_panel="twin")
def compare_rigs_command(
    session: Annotated[Path, typer.Argument(help="Scan of the item on the bench.", callback=existing_data)],
    rig: Annotated[str, config_option("rig", "Rig file of the twin.")],
    item: Annotated[str, option("--item", "Scanned item, by its name in the twin's world.")],
    calibration: Annotated[
        Path, option("--calibration", "Calibration of the bench.", callback=existing_file)
    ],
    json: Json = False,
) -> None:
    """Compare a bench with its twin on one scan: predicted and measured figures, calibrations exchanged.

    Each figure is shown next to its predicted 95 % interval. The frames of bench and twin are then
    triangulated with both calibrations: if the other calibration is as good as its own, both describe the
    same bench. The true shape is aligned with the points. The item should stand on the bench as in the
    twin's world.

    Example: `fpplab compare-rigs scan --rig matched/rig.yaml --item pyramid --calibration bench.yaml`
    """
    from fpplab.calibration.model import Calibration
    from fpplab.devices.rig import Rig
    from fpplab.sessions.session import Session
    from sim.matching.judging.compared_rigs import compare_rigs

    scan, bench_calibration = Session.open(session), Calibration.load(calibration)
    with Rig.load(rig) as twin, console.progress("Comparing"):
        answer = compare_rigs(twin, scan, item, bench_calibration).summary()
    console.print_result(answer, json, lambda: _show(answer))


def _show(answer: dict[str, Any]) -> None:
    rows = [
        [name, *(f"{figure[key]:.4g}" for key in ("measured", "predicted", "low", "high"))]
        for name, figure in answer["figures"].items()
    ]
    columns = ["figure", "measured", "predicted", "at least", "at most"]
    console.table(f"The bench's {answer['item']} and its twin's", columns, rows)
    crossed = [
        [name.replace("_", " "), f"{figure['distance_um']:.4g}", f"{figure['noise_um']:.4g}"]
        for name, figure in answer["crossed"].items()
    ]
    console.table("Frames by calibration", ["", "distance in µm", "noise in µm"], crossed)
    if answer["outside"]:
        console.log_status(f"outside of the predicted interval: {', '.join(answer['outside'])}")
