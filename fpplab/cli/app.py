"""The program, and the options that commands have in common."""

import inspect
import sys
from collections.abc import Callable
from copy import copy
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer
from typer.core import TyperGroup
from typer.models import CommandInfo, TyperInfo

from fpplab.cli import console, logs
from fpplab.cli.advice import unknown_command
from fpplab.cli.completion import CHECKS, config_option, existing_file, option
from fpplab.cli.lists import global_first
from fpplab.cli.trace import TRACE
from fpplab.core.confirmation import ConfirmationRequired, confirm_in_advance
from fpplab.core.errors import Cancelled, ConfigError
from fpplab.core.lattice import Lattice
from fpplab.core.logs import trace_devices
from fpplab.core.version import __version__

Info = TypeVar("Info", CommandInfo, TyperInfo)


class Commands(TyperGroup):
    """A group of commands that says which one was meant, and reports Ctrl-C as `Cancelled`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        try:
            return super().parse_args(ctx, args if ctx.parent else global_first(args))
        except Exception as error:
            _explain(error, args, ctx)
            raise

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        if not ctx.resilient_parsing and self.get_command(ctx, args[0]) is None:
            purposes = {name: each.get_short_help_str(500) for name, each in self.commands.items()}
            raise ConfigError(unknown_command(ctx.command_path, args[0], purposes))
        name, command, rest = super().resolve_command(ctx, args)
        if command is not None and (callback := command.callback) and not hasattr(command, "commands"):
            command = copy(command)  # the next call has other checks
            command.callback = partial(_check_and_run, ctx.meta, callback)
        return name, command, rest

    def invoke(self, ctx: Any) -> Any:
        words = [*ctx._protected_args, *ctx.args]  # noqa: SLF001 - which click has no public name for
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            raise Cancelled("cancelled") from None
        except Exception as error:
            _explain(error, words, ctx)
            raise


def _check_and_run(meta: dict[str, Any], callback: Callable[..., Any], **values: Any) -> Any:
    for check in meta.pop(CHECKS, []):
        check()
    return callback(**values)


def _explain(error: Exception, words: list[str], context: Any) -> None:
    if hasattr(error, "format_message"):  # only errors of usage have it
        from fpplab.cli.usage import usage_sentence

        if sentence := usage_sentence(error, words, context):
            raise ConfigError(sentence) from error


app = typer.Typer(
    name="fpplab",
    cls=Commands,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",
    context_settings={"help_option_names": ["--help", "-h"]},
    help="""Measure surfaces by fringe projection, on a bench or on its digital twin.

A **rig** file lists the devices, a **plan** the patterns to project, a **target** describes a board. The
usual order is `characterise` (calibrate) once, then `scan`, then `compare` with the true shape.
`fpplab demo` does all of this on the virtual bench and writes a report.

Commands of `data`, `system`, `twin` and `plan` also work alone: `fpplab doctor` is `fpplab system doctor`.
Exit codes: 0 done, 2 wrong input, 3 device, 4 data or a useless result,
5 calibration, 130 cancelled.""",
)


def _show_version(requested: bool) -> None:
    if requested:
        typer.echo(f"fpplab {__version__}")
        raise typer.Exit


@app.callback()
def _fpplab(
    context: typer.Context,
    _version: Annotated[
        bool, option("--version", "Print the version.", is_eager=True, callback=_show_version)
    ] = False,
    verbose: Annotated[bool, option("--verbose -v", "Report each step and its duration on stderr.")] = False,
    log: Annotated[
        Path | None, option("--log", "Append the same messages, with all details, to this file.")
    ] = None,
    trace: Annotated[
        bool,
        option(
            "--trace",
            "Also log everything sent to and received from the devices: in the session's log, in the "
            "file of --log, and with --verbose on stderr. At the end print the time and data of each phase.",
        ),
    ] = False,
    allow: Annotated[
        list[ConfirmationRequired] | None,
        option(
            "--allow",
            "Agree in advance to what cannot be undone or may harm a device: "
            f"{', '.join(ConfirmationRequired)}. Without a terminal it is refused otherwise.",
            metavar="ACT",
        ),
    ] = None,
    allow_backend: Annotated[
        list[str] | None,
        option(
            "--allow-backend",
            "Allow rig files to use device drivers from this module or package, which is then "
            "imported and run.",
            metavar="MODULE",
        ),
    ] = None,
) -> None:
    """Options of every command, before or after its name."""
    if allow_backend:
        from fpplab.devices.backends import allow_backends

        allow_backends(allow_backend)
    confirm_in_advance(allow or ())
    trace_devices(trace)
    if trace:
        TRACE.enabled = True
        context.call_on_close(console.print_trace)
    logs.start_logging(verbose, log, sys.argv[1:])


START, PREPARE, MEASURE = "Start here", "Prepare a rig", "Measure"
JUDGE, TWIN = "Compare with the true shape", "Use the digital twin"
PANELS = (START, PREPARE, MEASURE, JUDGE, TWIN)
"""Headings of `fpplab --help`, which fits one screen, in its order; a command names its own."""

GROUPS: dict[str, list[str]] = {"data": [], "plan": [], "system": [], "twin": []}
"""What a rare command names in place of a heading, and which do: `fpplab --help` shows them below the group
only, and `fpplab doctor` is `fpplab system doctor`. Filled by `arrange_commands`."""


def is_single_command(program: typer.Typer) -> bool:
    alone = len(program.registered_commands) == 1 and not program.registered_groups
    return alone and program.registered_callback is None


def leave_out_parameters() -> None:
    """Leave out of the commands what `fpplab --help` does not show: to build it takes a fifth of its time."""
    for command in app.registered_commands:
        command.help = command.help or inspect.getdoc(command.callback)
        command.callback = lambda: None
    for group in app.registered_groups:
        if group.typer_instance is not None:
            group.typer_instance.registered_commands.clear()
            group.typer_instance.registered_groups.clear()


def arrange_commands() -> None:
    """Sort the commands by heading and name, and put those of groups into these too."""
    for name, panel, purpose in (
        ("data", MEASURE, "Import, decode, convert and export recordings and results."),
        ("system", START, "Check this computer, report bugs, run devices and services."),
    ):
        group = typer.Typer(cls=Commands, help=purpose, no_args_is_help=True)
        app.add_typer(group, name=name, rich_help_panel=panel)
    groups = {info.name: info.typer_instance for info in app.registered_groups}
    for owner, names in GROUPS.items():
        inside = groups[owner]
        assert inside is not None
        for info in [each for each in app.registered_commands if each.rich_help_panel == owner]:
            inside.registered_commands.append(_shown_below(info))
            names.append(str(info.name))
        for each in [each for each in app.registered_groups if each.rich_help_panel == owner]:
            inside.registered_groups.append(_shown_below(each))
            names.append(str(each.name))
    app.registered_commands.sort(
        key=lambda each: ([panel != each.rich_help_panel for panel in PANELS], each.name or "")
    )


def _shown_below(info: Info) -> Info:
    """Hide a command where it is, and give a copy that a group shows."""
    copied = copy(info)
    copied.rich_help_panel, info.hidden = None, True
    return copied


Json = Annotated[bool, option("--json", "Print one JSON object on stdout and everything else on stderr.")]
Force = Annotated[bool, option("--force", "Replace the output if it exists.")]
AsRecorded = Annotated[
    bool,
    option(
        "--as-recorded",
        "Use the frames in the order recorded, even if they appear out of step with the plan.",
    ),
]
ImagePlaces = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="FOLDER | FILE...",
        help="Folder of grey images, or the image files in the order shown, each with one or several "
        "images: PNG, TIFF, BMP, PGM, PPM, JPEG, NPY, or NPZ with one array.",
        show_default=False,
    ),
]
FrameNames = Annotated[
    str | None,
    option(
        "--frames",
        "File names of the images in the folder: 'f_{index:02d}.png', 'set{set}_step{step}.png', "
        "'*.png' (sorted by the numbers in the names), or '@list.txt' (a file with one name per "
        "line).",
    ),
]
ImageBits = Annotated[
    int | None,
    option("--bits", "Bits per grey level: 8, 10, 12, 14 or 16. Default: detected from the images."),
]
FirstIndex = Annotated[
    int,
    option("--first", "Number of the first image; with {set} and {step}, the first number of both.", min=0),
]
FirstStep = Annotated[
    int | None, option("--first-step", "Number of the first {step}, if it differs from --first.", min=0)
]
CameraSize = Annotated[
    tuple[int, int] | None,
    option("--camera-size", "Width and height of the camera image in px, if no file states it."),
]
ProjectorSize = Annotated[
    tuple[int, int] | None,
    option("--projector-size", "Width and height of the projector image in px, if no file states it."),
]
ProjectorLattice = Annotated[
    Lattice | None,
    option(
        "--lattice",
        "Arrangement of the projector's mirrors, if no file states it. A LightCrafter 4500 has a "
        "diamond lattice.",
    ),
]
SkippedImages = Annotated[
    str | None,
    option(
        "--skip",
        "Images to ignore, such as white and black ones: '0,1' or '0-1', numbered from --first.",
        metavar="NUMBERS",
    ),
]
RigName = Annotated[str, config_option("rig", "Rig file, or the name of a rig supplied with fpplab.")]
PlanName = Annotated[str, config_option("plan", "Plan file: what to project and capture.")]
CalibrationOption = Annotated[
    Path,
    option("--calibration", "Calibration file written by `fpplab characterise`.", callback=existing_file),
]
LimitsOption = Annotated[
    Path | None, option("--limits", "File that overrides the default limits (for experts).")
]
DepthOption = Annotated[
    tuple[float, float] | None,
    option(
        "--depth",
        "Nearest and farthest distance of the object from the camera in mm. Default: `depth_mm` "
        "of the plan, otherwise of the rig file.",
        metavar="NEAR FAR",
    ),
]
CertificateFolder = Annotated[
    Path | None,
    option(
        "--certificate",
        "Folder with certificate.pem and key.pem, needed when the scheduler is on another computer.",
        metavar="FOLDER",
    ),
]
Out = Annotated[Path, option("--out", "Output file or folder.")]


class YesNo(StrEnum):
    """An answer on the command line."""

    YES = "yes"
    NO = "no"


DrawReport = Annotated[YesNo, option("--report", "Whether to draw the report.")]
ReportOption = Annotated[Path | None, option("--report", "Write a report as a single HTML file.")]
