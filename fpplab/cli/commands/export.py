"""`fpplab export`: clouds, calibrations and tables in the files of other programs."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fpplab.cli import console
from fpplab.cli.app import Force, Json, app
from fpplab.cli.completion import existing_file, option
from fpplab.core.errors import ConfigError
from fpplab.core.files import make_directory, need_suffix, refuse_existing

if TYPE_CHECKING:
    from fpplab.core.tables import Row


_NOT_IN_NAMES = re.compile(r"[^\w.-]")  # of files: the keys of a foreign answer may lead anywhere


@app.command("export", rich_help_panel="data")
def export_command(
    source: Annotated[
        Path,
        typer.Argument(
            help="Point cloud, session with its cloud, calibration, JSON output of a command, or journal.",
            callback=existing_file,
        ),
    ],
    out: Annotated[
        Path, option("--out -o", "Output file, whose suffix selects the format; some formats are folders.")
    ],
    layout: Annotated[
        str | None,
        option(
            "--layout", "Layout of an exported calibration: opencv, slstudio, matlab, bouguet, ros, or table."
        ),
    ] = None,
    table: Annotated[str | None, option("--table", "Table to write, if --out is a single file.")] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Export a cloud, a calibration or tables in the formats of other programs.

    Clouds: .e57 and .las or .laz (in m), .ply, .xyz, .npz, and .csv with all data of each point; .obj, .stl
    and .3mf of the surface along the pixel grid (in mm). Calibrations: .xml, .yml or .json of OpenCV, .xml
    of SLStudio, .mat for MATLAB or Bouguet's toolbox, a folder with `camera_info` of ROS, .csv. JSON output
    of commands and journals (.jsonl): .csv of one table, or a folder with all tables.

    Examples: `fpplab export scan --out part.e57`;
    `fpplab export calibration.yaml --layout ros --out ros`; `fpplab export compare.json --out tables`
    """
    refuse_existing(out, force and bool(out.suffix))
    kind = _kind_of(source)
    if layout is not None and kind != "calibration":
        raise ConfigError(f"{source}: is no calibration, and only a calibration has a --layout")
    if table is not None and kind != "tables":
        raise ConfigError(f"{source}: is no answer or journal, and only these have a --table")
    with console.progress("Exporting"):
        if kind == "cloud":
            answer = _export_cloud(source, out)
        elif kind == "calibration":
            answer = _export_calibration(source, out, layout)
        else:
            answer = _export_tables(source, out, table)
    console.print_result({"file": out, **answer}, json)


def _kind_of(source: Path) -> str:
    from fpplab.clouds import READ_SUFFIXES
    from fpplab.core.file_kinds import FOREIGN_CALIBRATIONS, describe_file

    suffix = source.suffix.lower()
    if source.is_dir() or suffix in READ_SUFFIXES:
        return "cloud"
    kind = describe_file(source)
    if suffix in (".yaml", ".yml") or kind in FOREIGN_CALIBRATIONS:  # which the reader of calibrations names
        return "calibration"
    if suffix in (".json", ".jsonl"):
        return "tables"
    content = kind or "of another kind by its name"
    raise ConfigError(
        f"{source}: is {content}; expected a cloud ({', '.join(READ_SUFFIXES)}), a session, a calibration "
        "(.yaml), or an answer or journal of fpplab (.json, .jsonl)"
    )


def _export_cloud(source: Path, out: Path) -> dict[str, Any]:
    from fpplab.clouds import load_cloud
    from fpplab.clouds.exchange import check_exported, export_cloud

    check_exported(out)
    cloud = load_cloud(source)
    export_cloud(cloud, out)
    return {"points": len(cloud)}


def _export_calibration(source: Path, out: Path, layout: str | None) -> dict[str, Any]:
    from fpplab.calibration.model import Calibration
    from fpplab.calibration.variants import export_calibration, layout_of

    chosen = layout or layout_of(out)
    export_calibration(Calibration.load(source), out, chosen)
    return {"layout": chosen}


def _export_tables(source: Path, out: Path, name: str | None) -> dict[str, Any]:
    from fpplab.core.tables import read_tables, write_csv

    tables = read_tables(source)
    if name is not None and name not in tables:
        raise ConfigError(f"--table: '{name}' must be one of {', '.join(tables)}")
    if out.suffix:
        need_suffix(out, ".csv")
        chosen = name or _only(tables, source)
        write_csv(out, tables[chosen])
        return {"tables": {chosen: len(tables[chosen])}}
    exported = {name: tables[name]} if name else tables

    def fill(draft: Path) -> None:
        for table, rows in exported.items():
            write_csv(draft / f"{_NOT_IN_NAMES.sub('_', table)}.csv", rows)

    make_directory(out, fill)
    return {"tables": {table: len(rows) for table, rows in exported.items()}}


def _only(tables: dict[str, list[Row]], source: Path) -> str:
    if len(tables) > 1:
        raise ConfigError(
            f"{source}: holds {len(tables)} tables ({', '.join(tables)}); choose one with --table, or give a "
            "folder, without suffix, for all"
        )
    return next(iter(tables))
