"""`fpplab artefact`: write the true shape of an artefact."""

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import JUDGE, Force, Json, Out, app
from fpplab.cli.completion import option
from fpplab.core.errors import ConfigError
from fpplab.core.files import check_new_file

_SHAPES = Path(__file__).parents[2] / "artefacts" / "shapes"
_NAMES = sorted(path.stem for path in _SHAPES.glob("[!_]*.py"))
"""Names of the artefacts by their files, for `--help`: to import them takes longer."""


@app.command("artefact", rich_help_panel=JUDGE)
def artefact_command(
    name: Annotated[str, typer.Argument(help=f"{', '.join(_NAMES[:-1])} or {_NAMES[-1]}.")],
    out: Out,
    layer: Annotated[
        float | None, option("--layer", "Model the print with layers of this height in mm.")
    ] = None,
    bead: Annotated[
        float | None, option("--bead", "Depth in mm of the grooves between layers on walls.")
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write the true shape of an artefact as STL, in mm.

    It is printed, and scans are compared with it. Print the exact shape, but compare with the shape as
    sliced: layers of 0.2 mm turn a slope into a staircase that is up to 0.1 mm off, and leave marks on walls,
    which would otherwise count as measurement errors.

    Example: `fpplab artefact pyramid --out pyramid.stl`, and after printing `fpplab artefact pyramid --layer
    0.2 --bead 0.03 --out printed.stl`
    """
    from fpplab import artefacts

    check_new_file(out, force, ".stl")
    if bead is not None and layer is None:
        raise ConfigError("--bead: marks lie between layers; give the height of a layer too, with --layer")
    mesh = artefacts.make(name)
    printed = {}
    if layer is not None:
        printed["layers"] = artefacts.layer_count(mesh.extents[2], layer)
        with console.progress("Slicing"):
            mesh = artefacts.slice_as_printed(mesh, layer, bead or 0.0)
    artefacts.save_stl(mesh, out)
    result = {"size_mm": mesh.extents.tolist(), "faces": len(mesh.faces), "mesh": str(out)}
    console.print_result(result | printed, json)
