"""`fpplab dlp4500 build|upload`: patterns in the projector's flash."""

from contextlib import closing
from pathlib import Path
from typing import Annotated

import typer

from drivers.dlp4500.bench_commands import NAME, EchoOption, ProjectorSerialOption, connect_projector, dlp4500
from fpplab.cli import console
from fpplab.cli.app import Force, Json, Out
from fpplab.cli.completion import existing_config, existing_file, names_of, option
from fpplab.core.confirmation import ConfirmationRequired, can_confirm, confirm, how_to_confirm
from fpplab.core.errors import Cancelled, ConfigError
from fpplab.core.files import check_new_file, refuse_existing, write_atomic, write_text


@dlp4500.command()
def build(
    plan: Annotated[
        str,
        typer.Argument(
            metavar="PLAN",
            help="Plan file with the patterns to store.",
            autocompletion=names_of("plan"),
            callback=existing_config("plan"),
        ),
    ],
    base: Annotated[Path, option("--base", "Firmware file of the manufacturer, or one built earlier.")],
    out: Out,
    force: Force = False,
    json: Json = False,
) -> None:
    """Build a firmware file with the patterns of a plan, for the projector to show from flash.

    Each image has 24 bit planes, for three patterns of 8 bits or six of 4, sampled on the diamond lattice of
    the mirrors and corrected with the response of the plan; the grey levels of `fpplab gamma` and `fpplab
    check` are appended. The images of BASE are replaced, its program is not changed. An index, a .yaml file
    next to OUT, lists the place of each pattern: the rig file refers to it as `flash`.

    Example: `fpplab dlp4500 build plan_paper.yaml --base DLPR350PROM.bin --out patterns.bin`
    """
    from drivers.dlp4500.flash.firmware import Firmware, arrange_patterns
    from drivers.dlp4500.index import FlashIndex
    from drivers.dlp4500.sequence import SIZE
    from fpplab.core import config
    from fpplab.core.conventions import Lattice
    from fpplab.patterns.fringes import make_patterns, uniform_patterns
    from fpplab.patterns.plan import Plan
    from fpplab.setup.rig_check.marker import marker

    check_new_file(out, force, ".bin")
    chosen = Plan.load(plan)
    chosen.check_projector(SIZE, plan)
    firmware = Firmware.load(base)
    with console.stopwatch() as seconds:
        greys = sorted({*chosen.greys.shown, *marker().tolist()})
        patterns = [*make_patterns(chosen, SIZE, Lattice.DIAMOND), *uniform_patterns(greys, SIZE)]
        built = firmware.with_patterns(patterns, out)
        listed = config.dump(FlashIndex.of(patterns, arrange_patterns(patterns)))
    index = out.with_suffix(".yaml")
    if not _holds(index, listed):  # as a command leaves it that was killed between the two files
        refuse_existing(index, force)
        out.unlink(missing_ok=True)  # never another file's index next to it
        write_text(index, listed)
    write_atomic(out, lambda stream: stream.write(built.content))
    result = {
        "firmware": str(out),
        "index": str(index),
        "patterns": len(patterns),
        "images": built.images,
        "image_bytes": built.splash.size,
        "seconds": seconds(),
    }
    console.print_result(result, json)


def _holds(file: Path, text: str) -> bool:
    return file.is_file() and file.read_bytes() == text.encode("utf-8")


@dlp4500.command()
def upload(
    firmware: Annotated[
        Path,
        typer.Argument(metavar="FIRMWARE", help="Written by `fpplab dlp4500 build`.", callback=existing_file),
    ],
    serial: ProjectorSerialOption = None,
    echo: EchoOption = True,
    yes: Annotated[bool, option("--yes", "Erase without asking, as with `--allow erase-flash`.")] = False,
    dry_run: Annotated[
        bool, option("--dry-run", "List what would be erased and written, without changing anything.")
    ] = False,
    json: Json = False,
) -> None:
    """Write the patterns of a built firmware file into the projector's flash.

    Lists what will be erased and asks for confirmation; without a terminal it needs `--allow erase-flash` or
    --yes. Only the sectors of the images are written and, if these move, the sector of the flash table,
    never the boot loader; each is verified by checksum. After an interruption the same command continues.

    Only tested on an emulated projector: have TI's own tool and firmware at hand.

    Example: `fpplab dlp4500 upload patterns.bin`
    """
    from drivers.clock import RealClock
    from drivers.dlp4500.flash.firmware import Firmware
    from drivers.dlp4500.flash.loader import boot_loader_session
    from drivers.dlp4500.flash.upload import check_firmware, perform_upload, plan_upload, verify_image_count

    built = Firmware.load(firmware)
    check_firmware(built)
    if not (yes or dry_run or can_confirm(ConfirmationRequired.ERASE_FLASH)):
        raise ConfigError(f"upload erases flash memory; {how_to_confirm(ConfirmationRequired.ERASE_FLASH)}")
    with console.stopwatch() as seconds:
        with boot_loader_session(lambda: connect_projector(serial, echo), RealClock(), NAME) as loader:
            work = plan_upload(built, loader)
            for sentence in work.summary:
                console.log_status(sentence)
            if dry_run:
                console.print_result({"sectors": work.sectors, "images": built.images, "dry_run": True}, json)
                return
            if not (yes or confirm(ConfirmationRequired.ERASE_FLASH, "Flash memory will be erased.")):
                raise Cancelled("cancelled: nothing was erased; --yes does not ask")
            with console.progress("Writing") as report:
                perform_upload(built, loader, work, report)
        with closing(connect_projector(serial, echo)) as link:
            verify_image_count(built, link)
    console.print_result({"sectors": work.sectors, "images": built.images, "seconds": seconds()}, json)
