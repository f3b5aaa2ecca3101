"""`fpplab match`: fit a twin to the recordings of a bench."""

from __future__ import annotations

from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typing_extensions import override

from fpplab.cli import console
from fpplab.cli.app import TWIN, Force, Json, Out
from fpplab.cli.completion import config_option, option
from fpplab.cli.lists import VariadicOptionsCommand
from fpplab.cli.viewing import KeepOpen, ViewOption, open_viewer
from fpplab.core.errors import ConfigError
from fpplab.core.progress import Progress, Say
from fpplab.core.session_names import RECORDING
from sim.matching.observer import MatchObserver

if TYPE_CHECKING:
    from fpplab.viewer.viewer import Viewer
    from sim.matching.record import MatchingEpoch
    from sim.matching.reference import Reference
    from sim.matching.run import MatchingRequest
    from sim.matching.view import MatchingView
    from sim.twin import Twin

program = typer.Typer()


@program.command("match", cls=VariadicOptionsCommand, rich_help_panel=TWIN)
def match_command(
    context: typer.Context,
    twin: Annotated[
        str, config_option("rig", "Rig file of the nominal twin, with values from data sheets.", "--twin")
    ],
    out: Out,
    reference: Annotated[
        list[Path] | None,
        option("--reference", "Sessions of a board recorded on the bench, or their folder."),
    ] = None,
    gamma: Annotated[
        Path | None, option("--gamma", "Response of the bench, written by `fpplab gamma`.")
    ] = None,
    scan: Annotated[
        list[str] | None,
        option("--scan", "ITEM=SESSION: scan of an artefact on the bench, used to judge the twin."),
    ] = None,
    surface: Annotated[
        list[str] | None,
        option(
            "--surface",
            "ITEM=SESSION: scan of a part on the bench, to match its reflectance and gloss; may be "
            "used without --reference if the twin is already matched.",
        ),
    ] = None,
    card: Annotated[
        str,
        option(
            "--card",
            "Name of the grey card in the twin's fixture; with ITEM=SESSION a scan of the card, to "
            "match its pose.",
        ),
    ] = "grey_card",
    accept: Annotated[
        list[str] | None, option("--accept", "CAUSE: proceed despite this finding; the twin keeps a warning.")
    ] = None,
    target: Annotated[
        str | None, config_option("target", "Target file of the board. Default: the twin's.")
    ] = None,
    item: Annotated[str, option("--item", "Name of the board in the twin's fixture.")] = "board",
    epochs: Annotated[int, option("--epochs", "Maximum number of epochs.", min=1)] = 25,
    seconds: Annotated[
        float, option("--seconds", "Time limit in s, excluding the final comparison.", min=1)
    ] = 900.0,
    alpha: Annotated[float, option("--alpha", "Weight of log(1 + |ε_d|) in the loss.", min=0)] = 0.2,
    beta: Annotated[float, option("--beta", "Weight of 1 - SSIM in the loss.", min=0)] = 0.8,
    view: ViewOption = False,
    keep_open: KeepOpen = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Match a twin to a bench, using only recordings of the bench.

    Matches the gamma first, then the characterisation by minimising `L = a log(1 + |ε_d|) + b (1 - SSIM)`,
    then the surfaces of parts: reflectance and gloss of each part, as opposed to those of the board's paper.
    OUT contains the matched twin (`rig.yaml`, accepted by every command), `match.jsonl` with every epoch,
    and `report.html`. `verdict` says whether the twin can be trusted, `findings` why not; an unusable twin
    is not written, and the exit code is 4. The same command continues an interrupted matching, and with
    `--accept CAUSE` a refused one; every command that uses the twin then repeats what was accepted.

    Example: `fpplab match --twin rig_twin --reference board/ --gamma response.yaml --scan pyramid=pyramid
    --out matched`
    """
    from fpplab.devices.rig import Rig
    from fpplab.sessions.session import recorded_sessions
    from fpplab.targets import Target
    from sim.matching.refusal import acceptable_causes
    from sim.matching.workflow import (
        MatchRequest,
        SurfacesRequest,
        check_match_output,
        match,
        match_surfaces_alone,
    )

    surfaces, accepted = _scan_options(surface or [], "--surface"), acceptable_causes(accept or [])
    if not reference:
        alone = SurfacesRequest(Rig.load(twin), surfaces, out, item, accepted, force)
        answer = match_surfaces_alone(alone, ConsoleMatchObserver()).summary()
        console.print_result(answer, json, lambda: _show_surfaces(answer["surfaces"]))
        return
    matching = _matching_request(item, card, gamma, scan or [], alpha, beta, epochs, seconds)
    request = MatchRequest(
        twin=Rig.load(twin),
        sessions=recorded_sessions(reference),
        out=out,
        matching=replace(matching, surfaces=surfaces, accepted=accepted),
        target=Target.load(target) if target else None,
        force=force,
    )
    check_match_output(request)
    result = match(request, _observe_matching(context, view, keep_open, out))
    summary = result.summary()
    console.print_verdict_and_result(
        result.matching.diagnosis, str(out), summary, json, lambda: _show(summary)
    )


class ConsoleMatchObserver(MatchObserver):
    """Shows progress and epochs on stderr and, where one is given, in the viewer."""

    def __init__(self, viewer: Viewer[MatchingView] | None = None) -> None:
        self._viewer = viewer

    @override
    def stage(self, name: str) -> AbstractContextManager[Progress]:
        return console.progress(name)

    @override
    def work(self, name: str) -> AbstractContextManager[tuple[Progress, Say]]:
        return console.telling_progress(name)

    @override
    def message(self, sentence: str) -> None:
        console.log_status(sentence)

    @override
    def epoch(self, epoch: MatchingEpoch, reference: Reference, twin: Twin) -> None:
        loss = epoch.loss
        console.log_status(
            f"epoch {epoch.epoch}, {epoch.step}: loss {loss['loss']:.4f}, over the board "
            f"{loss['loss_board']:.4f}, SSIM {loss['ssim']:.4f} / {loss['ssim_board']:.4f}, ε_d "
            f"{loss['epsilon_d_px']:.4f} px{'' if epoch.accepted else ', taken back'}"
        )
        if self._viewer is not None:
            from sim.matching.view import MatchingView, show_twin

            self._viewer.show(MatchingView.epoch, epoch)
            show_twin(self._viewer, reference, twin)


def _observe_matching(
    context: typer.Context, with_viewer: bool, keep_open: bool, out: Path
) -> ConsoleMatchObserver:
    if not (with_viewer or keep_open):
        return ConsoleMatchObserver()
    from sim.matching.view import MatchingView

    return ConsoleMatchObserver(open_viewer(context, MatchingView, with_viewer, keep_open, out / RECORDING))


def _matching_request(
    board: str,
    card: str,
    gamma: Path | None,
    scans: list[str],
    alpha: float,
    beta: float,
    epochs: int,
    seconds: float,
) -> MatchingRequest:
    from fpplab.patterns.response import Response
    from fpplab.sessions.session import Session
    from sim.matching.loss import Weights
    from sim.matching.match import MatchingLimits
    from sim.matching.run import MatchingRequest

    card_item, _, card_session = card.partition("=")
    return MatchingRequest(
        board=board,
        card=card_item,
        card_scan=Session.open(Path(card_session)) if card_session else None,
        response=None if gamma is None else Response.load(gamma),
        scans=_scan_options(scans, "--scan"),
        weights=Weights(alpha=alpha, beta=beta),
        limits=MatchingLimits(epochs=epochs, seconds=seconds),
    )


def _show_surfaces(surfaces: list[dict[str, Any]]) -> None:
    rows = [
        [surface["item"], surface["kind"], name, surface[name], sigma]
        for surface in surfaces
        for name, sigma in surface["sigma"].items()
    ]
    console.table("Surfaces", ["item", "kind", "property", "value", "standard uncertainty"], rows)


def _scan_options(arguments: list[str], option: str) -> dict[str, Any]:
    from fpplab.sessions.session import Session

    scans = {}
    for argument in arguments:
        name, equals, path = argument.partition("=")
        if not (name and equals and path):
            raise ConfigError(f"{option}: '{argument}' must be ITEM=SESSION, such as pyramid=scans/pyramid")
        if name in scans:
            raise ConfigError(f"{option}: {name} is given twice")
        scans[name] = Session.open(Path(path))
    return scans


YES = {True: "yes", False: "no"}


def _show(result: dict[str, Any]) -> None:
    rows = [
        [YES[r["refined"]], YES[r["with_gamma"]], r["ssim"], r["ssim_board"], r["epsilon_d_px"], r["loss"]]
        for r in result["rows"]
    ]
    console.table("Matching", ["refined", "gamma", "SSIM", "on the board", "ε_d px", "loss"], rows)
    if result["artefacts"]:
        columns = ["item", "bench_um", "twin_um", "delta_um", "delta_percent"]
        scans = [[scan[name] for name in columns] for scan in result["artefacts"]]
        console.table("Artefacts", ["item", "bench µm", "twin µm", "Δ µm", "Δ %"], scans)
    if result["surfaces"]:
        _show_surfaces(result["surfaces"])
    console.stdout.print(
        f"{result['epochs']} epochs, {result['seconds']:.0f} s, {result['ended']}; twin: {result['rig']}, "
        f"report: {result['report']}",
        markup=False,
    )
