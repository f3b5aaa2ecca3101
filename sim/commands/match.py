"""`fpplab match`: fit a twin to the recordings of a bench."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fpplab.cli import console
from fpplab.cli.app import TWIN, Force, Json, Out
from fpplab.cli.completion import names_of
from fpplab.cli.lists import VariadicOptionsCommand
from fpplab.cli.viewing import ConsoleObserver, KeepOpen, ViewOption, open_viewer
from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.core.extras import need_extra
from fpplab.workflows.pose_causes import with_causes

if TYPE_CHECKING:
    from fpplab.diagnosis import FaultCause
    from sim.matching.reference import Reference


program = typer.Typer()


@program.command("match", cls=VariadicOptionsCommand, rich_help_panel=TWIN)
def match_command(
    context: typer.Context,
    twin: Annotated[
        str,
        typer.Option(
            "--twin",
            help="Rig file of the nominal twin: what data sheets tell.",
            autocompletion=names_of("rig"),
        ),
    ],
    out: Out,
    reference: Annotated[
        list[Path] | None,
        typer.Option("--reference", help="The bench's sessions of a board, or the folder that holds them."),
    ] = None,
    gamma: Annotated[
        Path | None, typer.Option("--gamma", help="The bench's response, written by `fpplab gamma`.")
    ] = None,
    scan: Annotated[
        list[str] | None,
        typer.Option("--scan", help="ITEM=SESSION: the bench's scan of an artefact, for the judgement."),
    ] = None,
    surface: Annotated[
        list[str] | None,
        typer.Option(
            "--surface",
            help="ITEM=SESSION: the bench's scan of a part, by which its reflectance and gloss are matched; "
            "without --reference on a twin that is matched already.",
        ),
    ] = None,
    card: Annotated[
        str,
        typer.Option(
            "--card",
            help="The response's grey card, as the twin's fixture calls it; ITEM=SESSION: and a scan of it, "
            "by which its pose is matched.",
        ),
    ] = "grey_card",
    accept: Annotated[
        list[str] | None,
        typer.Option("--accept", help="CAUSE: match although this speaks against it; the twin will tell."),
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(
            "--target",
            help="Target file of the board; the twin's own by default.",
            autocompletion=names_of("target"),
        ),
    ] = None,
    item: Annotated[str, typer.Option("--item", help="What the twin's fixture calls the board.")] = "board",
    epochs: Annotated[int, typer.Option("--epochs", min=1, help="At most so many.")] = 25,
    seconds: Annotated[
        float, typer.Option("--seconds", min=1, help="At most so long, without the comparison at the end.")
    ] = 900.0,
    alpha: Annotated[float, typer.Option("--alpha", min=0, help="Of log(1 + |ε_d|) in the loss.")] = 0.2,
    beta: Annotated[float, typer.Option("--beta", min=0, help="Of 1 - SSIM in the loss.")] = 0.8,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Match a twin to a bench, from the bench's recordings alone.

    Gamma matching, then characterisation matching by `L = α log(1 + |ε_d|) + β (1 - SSIM)`, then the surfaces
    of parts: reflectance and gloss, for this part and not for the board's paper. OUT gets the
    matched twin (`rig.yaml`, which every command takes), `match.jsonl` with every epoch, and `report.html`.
    `verdict` says whether to believe the twin, `findings` why not; a useless one is not written, and the exit
    code is 4. The same command continues an interrupted matching, and with `--accept CAUSE` a refused one;
    every command that uses the twin then tells what was accepted.

    Example: `fpplab match --twin rig_twin --reference board/ --gamma response.yaml --scan pyramid=pyramid
    --out matched`
    """
    from fpplab.devices.rig import Rig
    from fpplab.pipeline import REPORT
    from fpplab.sessions.session import Session, recorded_sessions
    from fpplab.targets import Target
    from sim.matching.record import EPOCHS
    from sim.matching.refusal import acceptable_causes
    from sim.matching.run import MatchingRequest, match_sessions, twin_of

    surfaces, accepted = _scans(surface or [], "--surface"), acceptable_causes(accept or [])
    if not reference:
        _match_surfaces_alone(twin, item, surfaces, out, accepted, force, json)
        return
    _make_way(out, force, EPOCHS, REPORT)
    need_extra("skimage")
    sessions = recorded_sessions(reference)
    card_item, _, card_session = card.partition("=")
    wanted = MatchingRequest(
        board=item,
        card=card_item,
        card_scan=Session.open(Path(card_session)) if card_session else None,
        accepted=accepted,
        response=_response(gamma),
        scans=_scans(scan or [], "--scan"),
        surfaces=surfaces,
        weights=_weights(alpha, beta),
        limits=_limits(epochs, seconds),
    )
    with ExitStack() as stack, console.stopwatch() as elapsed:
        rig = stack.enter_context(Rig.load(twin))
        known = twin_of(rig, item)
        board = Target.load(target) if target else known.target

        from fpplab.core.session_names import RECORDING
        from sim.matching.page import matching_provenance, write_matching_report
        from sim.matching.record import MatchingEpoch
        from sim.matching.view import MatchingView, show_twin

        viewer = open_viewer(context, MatchingView, view, keep_open, out / RECORDING)
        references: list[Reference] = []

        def observe(epoch: MatchingEpoch) -> None:
            loss = epoch.loss
            console.log_status(
                f"epoch {epoch.epoch}, {epoch.step}: loss {loss['loss']:.4f}, over the board "
                f"{loss['loss_board']:.4f}, SSIM {loss['ssim']:.4f} / {loss['ssim_board']:.4f}, ε_d "
                f"{loss['epsilon_d_px']:.4f} px{'' if epoch.accepted else ', taken back'}"
            )
            viewer.show(MatchingView.epoch, epoch)
            if view or keep_open:
                show_twin(viewer, references[0], known.with_parameters(epoch.parameters.parameters()))

        try:
            with console.telling_progress("Matching") as (report, tell):
                found = match_sessions(
                    *(known, sessions, board, out, wanted),
                    progress=report,
                    observe=observe,
                    tell=tell,
                    prepared=references.append,
                )
        except CalibrationError as error:
            raise with_causes(error, sessions, ConsoleObserver()) from error
        sources = matching_provenance(found, {**wanted.scans, **wanted.surfaces})
        result = {
            **found.summary(),
            "seconds": elapsed(),
            "provenance": {name: one.summary() for name, one in sources.items()},
            "rig": None if found.diagnosis.is_useless else str(out / RIG),
            "report": str(out / REPORT),
        }
        with console.progress("Drawing the report"):
            write_matching_report(out / REPORT, found, known, result, sources)
    console.conclude(found.diagnosis, str(out), result, json, lambda: _show(result))


RIG = "rig.yaml"
"""The matched twin, in the folder of a matching that was not refused."""


def _make_way(out: Path, force: bool, record: str, page: str) -> None:
    """Refuse to overwrite a finished matching; an unfinished or refused one is continued."""
    finished = (out / RIG).is_file() and (out / page).is_file()  # which is last
    if finished and not force:
        raise ConfigError(f"{out}: exists already; name another output, or add --force to replace it")
    if out.exists() and not (out / record).is_file() and any(out.iterdir()):
        raise ConfigError(f"{out}: exists and holds no matching; name another output")
    if force:
        for name in (record, page, RIG):
            (out / name).unlink(missing_ok=True)


def _response(gamma: Path | None) -> Any:
    from fpplab.patterns.response import Response

    return None if gamma is None else Response.load(gamma)


def _match_surfaces_alone(
    twin: str,
    board: str,
    surfaces: dict[str, Any],
    out: Path,
    accepted: frozenset[FaultCause],
    force: bool,
    json: bool,
) -> None:
    """Match surfaces of parts on a twin that was matched to its board before."""
    from fpplab.devices.rig import Rig
    from sim.matching.parts import match_parts
    from sim.matching.refusal import Refusals
    from sim.matching.run import twin_of

    if not surfaces:
        raise ConfigError("--reference: is missing; name the bench's sessions of a board, or a --surface")
    if out.exists() and any(out.iterdir()) and not force:
        raise ConfigError(f"{out}: exists already; name another output, or add --force to replace it")
    with console.stopwatch() as elapsed, Rig.load(twin) as rig:
        refusals, source = Refusals(accepted), Path(rig.source)
        known = twin_of(rig, board)
        with console.telling_progress("Matching") as (report, tell):
            notes = rig.file.notes or ()
            found = match_parts(*(known, surfaces, out, source, refusals, notes), progress=report, tell=tell)
    surfaces_found = [one.summary() for one in found]
    answer = {
        "surfaces": surfaces_found,
        "notes": [*notes, *refusals.notes],
        "seconds": elapsed(),
        "rig": str(out / RIG),
    }
    console.print_result(answer, json, lambda: _show_surfaces(surfaces_found))


def _show_surfaces(surfaces: list[dict[str, Any]]) -> None:
    rows = [
        [one["item"], one["kind"], name, one[name], sigma]
        for one in surfaces
        for name, sigma in one["sigma"].items()
    ]
    console.table("Surfaces", ["item", "kind", "property", "value", "standard uncertainty"], rows)


def _scans(words: list[str], option: str) -> dict[str, Any]:
    from fpplab.sessions.session import Session

    found = {}
    for word in words:
        name, equals, path = word.partition("=")
        if not (name and equals and path):
            raise ConfigError(f"{option}: '{word}' must be ITEM=SESSION, such as pyramid=scans/pyramid")
        if name in found:
            raise ConfigError(f"{option}: {name} is given twice")
        found[name] = Session.open(Path(path))
    return found


def _weights(alpha: float, beta: float) -> Any:
    from sim.matching.loss import Weights

    return Weights(alpha=alpha, beta=beta)


def _limits(epochs: int, seconds: float) -> Any:
    from sim.matching.match import MatchingLimits

    return MatchingLimits(epochs=epochs, seconds=seconds)


YES = {True: "yes", False: "no"}


def _show(result: dict[str, Any]) -> None:
    rows = [
        [YES[r["refined"]], YES[r["with_gamma"]], r["ssim"], r["ssim_board"], r["epsilon_d_px"], r["loss"]]
        for r in result["rows"]
    ]
    console.table("Matching", ["refined", "gamma", "SSIM", "on the board", "ε_d px", "loss"], rows)
    if result["artefacts"]:
        columns = ["item", "bench_um", "twin_um", "delta_um", "delta_percent"]
        scans = [[one[name] for name in columns] for one in result["artefacts"]]
        console.table("Artefacts", ["item", "bench µm", "twin µm", "Δ µm", "Δ %"], scans)
    if result["surfaces"]:
        _show_surfaces(result["surfaces"])
    console.stdout.print(
        f"{result['epochs']} epochs, {result['seconds']:.0f} s, {result['ended']}; twin: {result['rig']}, "
        f"report: {result['report']}",
        markup=False,
    )
