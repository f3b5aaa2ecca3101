"""`fpplab predict`: what a measurement will give, by a twin."""

from pathlib import Path
from typing import Annotated, Any

import typer

from fpplab.cli import console
from fpplab.cli.app import TWIN, Json
from fpplab.cli.completion import config_option, option

program = typer.Typer()


@program.command("predict", rich_help_panel=TWIN)
def predict_command(
    rig: Annotated[str, config_option("rig", "Rig file of a twin or virtual bench.")],
    plan: Annotated[str, config_option("plan", "Plan to project.")],
    item: Annotated[str, option("--item", "Item to measure, by its name in the twin's world.")],
    calibration: Annotated[
        Path | None, option("--calibration", "Calibration used to triangulate. Default: the twin's true one.")
    ] = None,
    json: Json = False,
) -> None:
    """Predict a measurement before making it.

    Predicts distance, lengths, noise, completeness, wrong orders and time. The distance is the one that
    `fpplab compare --align` will report, together with what the alignment removes. Each figure has a 95 %
    interval that includes the scatter of the noise, the uncertainty of the twin's geometry
    (`calibration.yaml`), and the differences between twin and bench (`discrepancy.yaml`); `fpplab match`
    writes both next to the rig file. A sample of the image rows is simulated.

    Example: `fpplab predict --rig matched/rig.yaml --plan plan_paper --item pyramid`
    """
    from fpplab.calibration.model import Calibration
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from sim.prediction import predict

    projected = Plan.load(plan)
    loaded = None if calibration is None else Calibration.load(calibration)
    with console.stopwatch() as elapsed, Rig.load(rig) as bench, console.progress("Predicting"):
        prediction = predict(bench, projected, item, loaded)
        answer = {**prediction.summary(), "predicted_in_s": elapsed()}
    console.print_result(answer, json, lambda: _show(answer))


UNITS = {
    "distance_um": ("distance from the surface, aligned", "µm", 1.0),
    "place_um": ("distance that the alignment removes", "µm", 1.0),
    "noise_um": ("noise", "µm", 1.0),
    "completeness": ("completeness", "%", 100.0),
    "wrong_order": ("chance of a wrong order", "", 1.0),
    "seconds": ("time of the images", "s", 1.0),
}


def _show(answer: dict[str, Any]) -> None:
    rows = []
    for name, (label, unit, scale) in UNITS.items():
        figure = answer[name]
        values = [f"{scale * figure[key]:.3g} {unit}".strip() for key in ("value", "low", "high")]
        if unit == "µm" and figure["high"] > 100.0 * figure["low"]:  # such an interval says nothing
            values[1:] = ["unknown", "unknown"]
        rows.append([label, *values])
    console.table(
        f"Prediction for the {answer['item']}", ["figure", "predicted", "at least", "at most"], rows
    )
    if answer["lengths"]:
        table = [
            [length["name"], *(f"{length[key]:.4f}" for key in ("true_mm", "value", "low", "high"))]
            for length in answer["lengths"]
        ]
        console.table("Lengths in mm", ["", "true", "predicted", "at least", "at most"], table)
    if not answer["matched"]:
        console.log_status(
            "no discrepancy.yaml next to the rig file: what the simulation lacks is not in the intervals"
        )
    if not answer["surface_known"]:
        item = answer["item"]
        console.log_status(
            f"no scan has shown the surface of the {item}, so that noise and distance are those of any "
            f"reflectance: `fpplab match --surface {item}=SESSION` matches it to a scan"
        )
    if answer["compared_stripes"]:
        console.log_status(
            f"fringes are finer than those of {answer['compared_stripes']:g} stripes by which bench and twin "
            "were compared, so that their contrast is uncertain: `fpplab match --scan ITEM=SESSION` with a "
            "scan by such a plan measures it"
        )
    if answer["looks_like"]:
        console.log_status(
            f"the twin's discrepancy looks like {answer['looks_like']}; not for {answer['not_for']}"
        )
