"""`fpplab verify`: acceptance test of a measuring system."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import JUDGE, Force, Json, Out, PlanName, app
from fpplab.cli.completion import names_of
from fpplab.cli.lists import VariadicOptionsCommand
from fpplab.cli.viewing import KeepOpen, ViewOption, open_viewer
from fpplab.core.errors import ConfigError, DataError

if TYPE_CHECKING:
    from fpplab.calibration.model import Calibration
    from fpplab.clouds import Cloud
    from fpplab.comparison.acceptance import Acceptance, Standard
    from fpplab.patterns.plan import Plan
    from fpplab.viewer.acceptance import AcceptanceView
    from fpplab.viewer.viewer import Viewer


@app.command("verify", cls=VariadicOptionsCommand, rich_help_panel=JUDGE)
def verify_command(
    context: typer.Context,
    standard: Annotated[
        str,
        typer.Option(
            "--standard", help="Standard file: the standards and limits.", autocompletion=names_of("standard")
        ),
    ],
    out: Out,
    spheres: Annotated[
        list[Path] | None, typer.Option("--spheres", help="Clouds or sessions of the ball bar, any number.")
    ] = None,
    planes: Annotated[
        list[Path] | None, typer.Option("--planes", help="Clouds or sessions of the plane, any number.")
    ] = None,
    mpe: Annotated[
        str, typer.Option("--mpe", help="Maximum permissible errors in µm, such as PF=50,SD=30.")
    ] = "",
    positions: Annotated[
        str,
        typer.Option(
            "--positions",
            help="Least numbers of positions, such as PF=10,SD=7. "
            "Default: the standard file's, or PF=10,PS=10,SD=7,F=6.",
        ),
    ] = "",
    rig: Annotated[
        str | None,
        typer.Option(
            "--rig", help="Measure the standard's items now, on this rig.", autocompletion=names_of("rig")
        ),
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option("--calibration", help="Of the rig, or of sessions without a cloud.")
    ] = None,
    plan: PlanName = "plan_paper.yaml",
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Acceptance test in the manner of VDI/VDE 2634 part 2, on a ball bar and a plane.

    Probing error of form PF and of size PS, sphere-spacing error SD and flatness measurement error F,
    each in µm beside its maximum permissible error. PF and F are the range of the points without the 3 ‰
    farthest from the fit; PF_all and F_all, given beside them, that of all points. The angle of incidence up
    to which a sphere's points count, 60° by default, is part of the result. `verdict` says whether to believe
    the system, `findings` why not. A test that is not passed is a result and no fault: the exit code is 0,
    and `passed` is false; with errors of ten times what is permitted it is 4. Writes OUT, a report.

    Examples: `fpplab verify --standard standard_demo --spheres bar1/cloud.ply bar2/cloud.ply
    --planes plane1/cloud.ply --out verify.html`;
    `fpplab verify --standard standard_demo --rig rig_demo --calibration calibration.yaml --out verify.html`
    """
    from fpplab.calibration.model import Calibration
    from fpplab.comparison.acceptance import Standard
    from fpplab.core.files import need_suffix, refuse_existing
    from fpplab.patterns.plan import Plan

    need_suffix(out, ".html")
    refuse_existing(out, force)
    if bool(spheres or planes) == bool(rig):
        raise ConfigError("give either --spheres and --planes, or --rig, to say where the points come from")
    known = Standard.load(standard).with_mpe(_words(mpe)).with_positions(_words(positions))
    model = Calibration.load(calibration) if calibration else None
    from fpplab.viewer.acceptance import AcceptanceView

    viewer = open_viewer(context, AcceptanceView, view, keep_open, out.with_suffix(".rrd"))
    with console.stopwatch() as seconds:
        bars, flats = _named(spheres or []), _named(planes or [])
        if rig:
            bars, flats = _measured(rig, known, model, Plan.load(plan), out, force, viewer)
        from fpplab.comparison.acceptance import verify as judge
        from fpplab.diagnosis.acceptance import diagnose_acceptance
        from fpplab.report.acceptance import write_acceptance_report
        from fpplab.results.provenance import source_provenance

        with console.progress("Verifying"):
            again = None if rig else model
            result = judge(known, _clouds(bars, again), _clouds(flats, again))
            viewer.show(AcceptanceView.result, result)
            diagnosis = diagnose_acceptance(result)
            all_of = {**bars, **flats}.items()
            sources = {name: source_provenance(path, model, calibration) for name, path in all_of}
            answer = {**diagnosis.summary(), **result.summary(), "seconds": seconds(), "report": str(out)}
            answer["provenance"] = {name: one.summary() for name, one in sources.items()}
            write_acceptance_report(out, result, diagnosis, answer, sources)
    console.conclude(diagnosis, str(out), answer, json, lambda: _show(result, out))


def _words(option: str) -> list[str]:
    return [word for word in option.split(",") if word.strip()]


def _named(paths: Sequence[Path]) -> dict[str, Path]:
    """Clouds and sessions by name. Raises `ConfigError` for one that is missing, or given twice."""
    names = [str(path) for path in paths]
    for path, name in zip(paths, names, strict=True):
        if names.count(name) > 1:
            raise ConfigError(f"{name}: is given twice; each position of a standard counts once")
        if not path.exists():
            raise ConfigError(f"{name}: there is no such cloud or session")
    return dict(zip(names, paths, strict=True))


def _clouds(sources: Mapping[str, Path], calibration: Calibration | None) -> Iterator[tuple[str, Cloud]]:
    for name, path in sources.items():
        yield name, _cloud(path, calibration)


def _cloud(path: Path, calibration: Calibration | None) -> Cloud:
    """A cloud from its file; or from a session: reconstructed anew if a calibration is given."""
    from fpplab.clouds import load_cloud
    from fpplab.pipeline import CLOUD, reconstruct_points
    from fpplab.sessions.session import Session

    if not path.is_dir():
        return load_cloud(path)
    if calibration:
        return reconstruct_points(Session.open(path), calibration)[1]
    if not (path / CLOUD).is_file():
        raise DataError(f"{path}: holds no {CLOUD}; give --calibration to reconstruct it")
    return load_cloud(path / CLOUD)


def _measured(
    rig: str,
    standard: Standard,
    calibration: Calibration | None,
    plan: Plan,
    out: Path,
    force: bool,
    viewer: Viewer[AcceptanceView],
) -> tuple[dict[str, Path], dict[str, Path]]:
    """Sessions of every item that the standard names, by item, scanned into a folder beside the report."""
    if calibration is None:
        raise ConfigError("--rig needs --calibration, the rig's own; make it with fpplab characterise")
    items = standard.items
    if not (items.ball_bar or items.plane):
        raise ConfigError(
            f"standard '{standard.name}': 'items' is empty; name what the rig's fixture holds, by position"
        )
    from fpplab.devices.rig import Rig
    from fpplab.pipeline import check_plan, check_space, finish_scan, take
    from fpplab.viewer.acceptance import AcceptanceView
    from fpplab.viewer.measurement import frame_observer

    loaded = Rig.load(rig)
    check_plan(plan, "--plan", calibration, loaded)
    folder = out.with_name(out.stem + "_scans")
    with loaded as bench:
        fixture, caps = bench.need_fixture("fpplab verify --rig"), bench.projector.caps
        plan.check_projector(caps.size, "--plan")
        calibration.check_camera(bench.camera.caps.size, "--calibration")
        calibration.check_projector(caps.size, caps.lattice, "--calibration")
        for item in (*items.ball_bar, *items.plane):
            fixture.check(item)
        check_space(bench, plan, [folder / item for item in (*items.ball_bar, *items.plane)], force)
        viewer.show(AcceptanceView.plan, plan, caps.size, caps.lattice)
        viewer.show(AcceptanceView.calibration, calibration)
        for item in (*items.ball_bar, *items.plane):
            with console.progress(f"Scanning {item}") as report:
                session = take(
                    *(bench, plan, folder / item, (item, 0)),
                    force=force,
                    complete_too=True,
                    progress=report,
                    observe_frame=frame_observer(viewer),
                )
                found = finish_scan(session, calibration)
                found.diagnosis.require_usable(str(session.path))
                if found.decoded is not None and found.cloud is not None:
                    viewer.show(AcceptanceView.position, item, found.decoded, found.cloud)
    return {name: folder / name for name in items.ball_bar}, {name: folder / name for name in items.plane}


def _show(result: Acceptance, out: Path) -> None:
    from fpplab.comparison.acceptance import VERDICTS

    rows = [
        [
            name,
            f"{found.positions} of {found.least_positions}",
            found.worst_um,
            "–" if found.worst_all_um is None else found.worst_all_um,
            found.mpe_um or "–",
            VERDICTS[found.passed],
        ]
        for name, found in result.judgements().items()
    ]
    heads = ["", "values", "worst µm", "of all points", "permitted µm", ""]
    console.table(f"Acceptance test: {result.standard.name}", heads, rows)
    console.stdout.print(f"spheres up to {result.standard.evaluation.cap_deg:g}° of incidence", markup=False)
    console.stdout.print(f"{VERDICTS[result.passed]}; report: {out}", markup=False)
