"""`fpplab convert`: calibrations of other programs."""

from pathlib import Path
from typing import Annotated

import typer

from fpplab.cli import console
from fpplab.cli.app import CameraSize, Force, Json, Out, ProjectorLattice, ProjectorSize, app
from fpplab.cli.completion import existing_file, option
from fpplab.core.errors import ConfigError
from fpplab.core.files import check_new_file, write_text
from fpplab.core.units import MM


@app.command("convert", rich_help_panel="data")
def convert_command(
    files: Annotated[
        list[Path],
        typer.Argument(
            help="An fpplab calibration, or the files of another program that together contain one.",
            callback=existing_file,
        ),
    ],
    out: Out,
    camera_size: CameraSize = None,
    projector_size: ProjectorSize = None,
    lattice: ProjectorLattice = None,
    unit: Annotated[
        str | None,
        option("--unit", "Unit of length (um, mm, cm, inch, m), if not the usual unit of the file format."),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Convert calibrations between fpplab and other programs.

    An fpplab calibration becomes an OpenCV FileStorage (M1 D1 M2 D2 R T; .xml or .yml). Files of OpenCV,
    SLStudio, procam-calibration, MATLAB and Bouguet's toolbox (lengths in mm), and of Kalibr, ROS and mrcal
    (lengths in m) become an fpplab calibration (.yaml).

    Examples: `fpplab convert calibration.yaml --out stereo.xml`;
    `fpplab convert stereo.yml --out calibration.yaml --camera-size 1368 912 --projector-size 912 1140
    --lattice diamond`; `fpplab convert camera.yml projector.yml extrinsics.yml --out calibration.yaml
    --lattice square`
    """
    from fpplab.calibration.dialects import is_own
    from fpplab.calibration.interchange import import_calibration, to_opencv
    from fpplab.calibration.model import Calibration

    own = [file for file in files if is_own(file)]
    if not own:
        check_new_file(out, force, ".yaml")
        if unit and unit not in MM:
            raise ConfigError(f"--unit is '{unit}': must be one of {', '.join(dict.fromkeys(MM))}")
        mm_per_unit = MM[unit] if unit else None
        calibration = import_calibration(
            files, camera_size, projector_size, lattice, mm_per_unit, console.log_status
        )
        calibration.save(out)
    elif len(files) == 1:
        if camera_size or projector_size or lattice or unit:
            raise ConfigError(
                f"{files[0]}: is a calibration of fpplab, which says itself what its devices are; leave "
                "sizes and lattice out, and the unit"
            )
        check_new_file(out, force, ".xml", ".yml")
        calibration = Calibration.load(files[0])
        if calibration.uncertainty:
            console.log_status(
                f"{out}: without the uncertainties of {files[0]}, for which OpenCV has no entry"
            )
        write_text(out, to_opencv(calibration, "xml" if out.suffix.lower() == ".xml" else "yaml"))
    else:
        raise ConfigError(f"{own[0]}: is a calibration of fpplab, which holds both devices; give it alone")
    console.print_result(
        {"file": out, "baseline_mm": calibration.baseline_mm, "lattice": str(calibration.projector.lattice)},
        json,
    )
