"""`fpplab optimise`: search for a better plan, on a twin or on the rig itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fpplab.cli import console
from fpplab.cli.app import TWIN, CertificateFolder, Force, Json, RigName, app
from fpplab.cli.completion import config_option, option
from fpplab.cli.viewing import KeepOpen, SearchObserver, ViewOption, make_observer
from fpplab.core.errors import ConfigError
from fpplab.optimisation.scope import SearchScope

if TYPE_CHECKING:
    from fpplab.optimisation.study import Study


@app.command("optimise", rich_help_panel=TWIN)
def optimise_command(
    context: typer.Context,
    what: Annotated[
        SearchScope, typer.Argument(help="Quantity to search: phases, stripes, baseline or pareto.")
    ],
    rig: RigName,
    out: Annotated[Path, option("--out", "Plan file to write (.yaml); for `pareto`, a folder of plans.")],
    study: Annotated[
        str | None, config_option("study", "Study file: search space, limits, objectives, method.")
    ] = None,
    calibration: Annotated[
        Path | None,
        option(
            "--calibration", "Calibration of the rig as it stands. Without it the rig is characterised first."
        ),
    ] = None,
    seeds: Annotated[
        int | None,
        option("--seeds", "Number of noise seeds per candidate, or of repeats on a real rig.", min=1),
    ] = None,
    workers: Annotated[
        int | None,
        option("--workers", "Number of worker processes. Default for simulated rigs: one per core.", min=1),
    ] = None,
    scheduler: Annotated[
        str | None,
        option("--scheduler", "Address of a `dask` scheduler whose workers evaluate the candidates."),
    ] = None,
    certificate: CertificateFolder = None,
    confirm: Annotated[
        str | None,
        config_option(
            "rig", "Rig on which the initial and the optimised plan are then compared.", "--confirm"
        ),
    ] = None,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Search for the best plan or baseline, usually on the twin.

    `phases` finds the fewest images that measure no worse than the initial plan. `stripes` and `baseline`
    minimise the mean distance to the surface. `pareto` finds the trade-off between that distance and the
    number of images. OUT can be given to `fpplab scan --plan`; a report and the journal are written next to
    it, and the same command continues an interrupted search from the journal. `verdict` says whether the
    optimum can be trusted, `findings` why not; if it is worse than the initial plan no plan is written and
    the exit code is 4.

    Example: `fpplab optimise stripes --rig rig_demo --out stripes.yaml --confirm rig_hidden`
    """
    from fpplab.optimisation.study import Study
    from fpplab.workflows.optimise import OptimisationRequest, run_optimisation

    if scheduler and workers:
        raise ConfigError(
            "--workers counts processes of this computer, and a --scheduler has its own: give one"
        )
    name = study or f"study_{what}.yaml"
    request = OptimisationRequest(
        scope=what,
        rig=rig,
        study=_study_with_overrides(Study.load(name), calibration, seeds),
        study_name=name,
        out=out,
        workers=workers,
        scheduler=scheduler,
        certificate=certificate,
        confirm=confirm,
        force=force,
    )
    observer = make_observer(context, SearchObserver, view, keep_open, request.page.with_suffix(".rrd"))
    result = run_optimisation(request, observer)
    answer = result.summary()
    console.print_verdict_and_result(result.diagnosis, str(out), answer, json, lambda: _show(answer))


def _study_with_overrides(study: Study, calibration: Path | None, seeds: int | None) -> Study:
    from fpplab.calibration.model import Calibration
    from fpplab.optimisation.problem import CalibrationAt

    changed: dict[str, Any] = {}
    if calibration is not None:
        Calibration.load(calibration)
        at = CalibrationAt(file=str(calibration.resolve()), stage_mm=study.start.stage_mm)
        changed["calibrations"] = (at,)
    if seeds is not None:
        changed["seeds"] = tuple(range(1, seeds + 1))
    return study.model_copy(update=changed)


def _sets_in_short(sets: list[dict[str, Any]]) -> tuple[str, str]:
    """Stripes or kind of each set of a plan, and its steps, bits or number of images."""
    stripes = (f"{each['stripes']:g}" if "stripes" in each else str(each["kind"]) for each in sets)
    lists = ("shifts_deg", "levels", "names")
    listed = (next((len(each[name]) for name in lists if name in each), 0) for each in sets)
    counts = (each.get("steps") or each.get("bits") or n for each, n in zip(sets, listed, strict=True))
    return " ".join(stripes), " ".join(map(str, counts))


def _show(result: dict[str, Any]) -> None:
    chosen = [("start", result["initial"]), ("optimum", result["optimum"])]
    chosen += [
        (f"front {i}", entry) for i, entry in enumerate(result["front"], 1) if len(result["front"]) > 1
    ]
    if result["screened"]:  # what was measured, not what was predicted
        chosen = [(name, {**entry, **(entry["again"] or {})}) for name, entry in chosen]
    columns = ["plan", "images", "stripes", "steps", "stage mm", "SMCD µm", "spread µm", "completeness"]
    rows = [
        [
            name,
            entry["images"],
            *_sets_in_short(entry["fringes"]),
            "" if entry["stage_mm"] is None else entry["stage_mm"],
            entry["surface_smcd_um"],
            "" if entry["smcd_spread_um"] is None else entry["smcd_spread_um"],
            entry["completeness"],
        ]
        for name, entry in chosen
    ]
    console.table(f"{result['study']} on {result['rig']}", columns, rows)
    for entry in result["confirmed"]:
        gain = f"{100 * entry['gain']:.1f} ± {100 * entry['uncertainty']:.1f} %"
        sentence = f"On {entry['rig']} {entry['plan']} is {gain} nearer to the surface than the start's plan."
        console.stdout.print(sentence)
    manner = "predicted, the plans above measured" if result["screened"] else "measured"
    console.stdout.print(
        f"{result['epochs']} epochs, {result['candidates']} candidates {manner}, {result['seconds']:.0f} s, "
        f"{result['ended']}; report: {result['report']}"
    )
