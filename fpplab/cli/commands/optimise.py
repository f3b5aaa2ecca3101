"""`fpplab optimise`: search for a better plan, on a twin or on the rig itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fpplab.cli import console
from fpplab.cli.app import TWIN, Force, Json, RigName, app
from fpplab.cli.completion import names_of
from fpplab.cli.viewing import KeepOpen, ViewOption, open_viewer
from fpplab.core.errors import ConfigError
from fpplab.core.extras import need_extra
from fpplab.optimisation.scope import SearchScope

if TYPE_CHECKING:
    from fpplab.optimisation.candidate_runner import SearchEpoch
    from fpplab.optimisation.study import Study


@app.command("optimise", rich_help_panel=TWIN)
def optimise_command(
    context: typer.Context,
    what: Annotated[SearchScope, typer.Argument(help="What to search.")],
    rig: RigName,
    out: Annotated[
        Path, typer.Option("--out", help="The plan (.yaml); of `pareto` the folder of its plans.")
    ],
    study: Annotated[
        str | None,
        typer.Option(
            "--study", help="Study file: space, limits, objectives, method.", autocompletion=names_of("study")
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option("--calibration", help="Of the rig as it stands; without, it is characterised first."),
    ] = None,
    seeds: Annotated[
        int | None, typer.Option("--seeds", min=1, help="Seeds 1 … N of the noise, or repeats on a real rig.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            min=1,
            help="Processes that measure; by default a simulation's are one for every core.",
        ),
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", help="Address of a `dask` scheduler whose workers measure.")
    ] = None,
    confirm: Annotated[
        str | None,
        typer.Option(
            "--confirm",
            help="Rig on which the start's plan and the one found are then compared.",
            autocompletion=names_of("rig"),
        ),
    ] = None,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Search phase counts, stripe counts, the baseline, or the front of all together.

    `phases`: the fewest images that measure no worse than the start's plan. `stripes` and `baseline`: the
    least mean distance to the surface. `pareto`: that distance against images. OUT is what `fpplab scan
    --plan` takes; beside it stay a report and the journal, from which an interrupted search goes on by the
    same command. `verdict` says whether to believe the optimum, `findings` why not; where it is worse than
    the start no plan is left, and the exit code is 4.

    Example: `fpplab optimise stripes --rig rig_demo --out stripes.yaml --confirm rig_hidden`
    """
    from fpplab.optimisation.study import Study

    name = study or f"study_{what}.yaml"
    wanted = _changed(Study.load(name), calibration, seeds)
    if scheduler and workers:
        raise ConfigError(
            "--workers counts processes of this computer, and a --scheduler has its own: give one"
        )
    _make_way(what, out, force)
    need_extra("optuna")
    need_extra("distributed")

    from fpplab.optimisation import confirm_result, run
    from fpplab.optimisation.verdict import diagnose_search
    from fpplab.report.optimisation import measure_search_maps, write_optimisation_report
    from fpplab.viewer.search import SearchView

    if confirm:
        confirm_result.check_confirmable(confirm, wanted, name)
    with console.stopwatch() as elapsed:
        page = run.report_path(what, out)
        viewer = open_viewer(context, SearchView, view, keep_open, page.with_suffix(".rrd"))

        def observe(epoch: SearchEpoch) -> None:
            console.log_status(_words(epoch))
            viewer.show(SearchView.epoch, epoch)

        with console.progress("Searching") as report:
            found = run.run_search(
                what,
                rig,
                wanted,
                out,
                name,
                workers=workers,
                scheduler=scheduler,
                observe=observe,
                progress=report,
            )
        confirmed: tuple[confirm_result.ConfirmedPlan, ...] = ()
        if confirm and found.plans:
            with console.progress("Confirming") as report:
                confirmed = confirm_result.confirm_result(
                    confirm, found, run.work_folder(out) / "confirm", report
                )
        diagnosis = diagnose_search(found, confirmed)
        if diagnosis.is_useless:
            for path in found.plans:
                path.unlink()
        result = {
            **diagnosis.summary(),
            **found.summary(),
            "confirmed": [one.summary() for one in confirmed],
            "seconds": elapsed(),
            "plans": [] if diagnosis.is_useless else [str(path) for path in found.plans],
            "report": str(page),
        }
        with console.progress("Comparing before and after"):
            maps = measure_search_maps(rig, found)
            result["provenance"] = {name: one.summary() for name, one in maps.provenance.items()}
            write_optimisation_report(page, found, confirmed, maps, result)
    console.conclude(diagnosis, str(out), result, json, lambda: _show(result))


def _changed(study: Study, calibration: Path | None, seeds: int | None) -> Study:
    """The study with what the command says instead. Raises `ConfigError`, `CalibrationError`."""
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


def _make_way(what: SearchScope, out: Path, force: bool) -> None:
    """Refuse to overwrite a finished search; an unfinished one is continued."""
    from fpplab.core.files import need_suffix
    from fpplab.optimisation.run import journal_paths, plan_paths, report_path

    if what is not SearchScope.PARETO:
        need_suffix(out, ".yaml")
    elif out.exists() and not out.is_dir():
        raise ConfigError(f"{out}: is a file; `pareto` leaves a folder of plans")
    plans = plan_paths(what, out)
    journals = journal_paths(what, out)
    begun = any(path.is_file() for path in journals) and not report_path(what, out).is_file()  # which is last
    if plans and not (force or begun):
        raise ConfigError(f"{plans[0]}: exists already; name another output, or add --force to replace it")
    if force:
        for path in (*plans, *journals):
            path.unlink(missing_ok=True)


def _words(epoch: SearchEpoch) -> str:
    best = epoch.best.figures
    return (
        f"epoch {epoch.number}, {epoch.step}: {epoch.measured} candidates; best {best.images} images, "
        f"{best.surface_smcd_um:.2f} µm"
    )


def _show(result: dict[str, Any]) -> None:
    chosen = [("start", result["initial"]), ("optimum", result["optimum"])]
    chosen += [(f"front {i}", one) for i, one in enumerate(result["front"], 1) if len(result["front"]) > 1]
    if result["screened"]:  # what was measured, not what was predicted
        chosen = [(name, {**one, **(one["again"] or {})}) for name, one in chosen]
    columns = ["plan", "images", "stripes", "steps", "stage mm", "SMCD µm", "spread µm", "completeness"]
    rows = [
        [
            name,
            one["images"],
            " ".join(f"{f['stripes']:g}" for f in one["fringes"]),
            " ".join(str(f["steps"]) for f in one["fringes"]),
            "" if one["stage_mm"] is None else one["stage_mm"],
            one["surface_smcd_um"],
            "" if one["smcd_spread_um"] is None else one["smcd_spread_um"],
            one["completeness"],
        ]
        for name, one in chosen
    ]
    console.table(f"{result['study']} on {result['rig']}", columns, rows)
    for one in result["confirmed"]:
        gain = f"{100 * one['gain']:.1f} ± {100 * one['uncertainty']:.1f} %"
        words = f"On {one['rig']} {one['plan']} is {gain} nearer to the surface than the start's plan."
        console.stdout.print(words, markup=False)
    how = "predicted, the plans above measured" if result["screened"] else "measured"
    console.stdout.print(
        f"{result['epochs']} epochs, {result['candidates']} candidates {how}, {result['seconds']:.0f} s, "
        f"{result['ended']}; report: {result['report']}",
        markup=False,
    )
