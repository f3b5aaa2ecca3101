"""Every kind of file given to every argument that takes a file: what each command says of it.

`python -m tests.cli.refusals` prints the table, and `--write` replaces the reviewed one, `refusals.yaml`. A
cell whose file is what the argument takes is left out: the command would begin its work.
"""

import contextlib
import io
import logging
import os
import shutil
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import yaml
from typer.main import get_command

from fpplab.cli.every import app
from fpplab.core.errors import FppError
from fpplab.core.file_kinds import describe_file
from tests.support.commands import ROOT
from tests.support.file_kinds import make_files

TABLE = Path(__file__).with_name("refusals.yaml")
Cells = dict[str, dict[str, str]]
"""What is said of each file, by the command line with FILE in its place; `kinds` has what KIND is."""

CALIBRATIONS, SESSIONS, RIGS, PLANS = "calibration.yaml", "my_session", "rig.yaml", "plan.yaml"
CLOUDS = "cloud.ply cloud.xyz cloud.npz cloud.csv cloud.txt part_mesh.ply my_session"
MESHES = "part.stl part.obj part_mesh.ply"
SCAN = "--rig rig.yaml --calibration calibration.yaml --plan plan.yaml --out o/s"
SIZES = "--camera-size 64 48 --projector-size 64 48"
ARGUMENTS = {
    f"scan {SCAN} --rig FILE": RIGS,
    f"scan {SCAN} --plan FILE": PLANS,
    f"scan {SCAN} --calibration FILE": CALIBRATIONS,
    f"scan {SCAN} --limits FILE": "limits.yaml",
    "exposure --rig FILE": RIGS,
    "exposure --rig rig.yaml --plan FILE": PLANS,
    "exposure --rig rig.yaml --calibration FILE": CALIBRATIONS,
    "reconstruct FILE --calibration calibration.yaml --out o/c.ply": SESSIONS,
    "reconstruct my_session --calibration FILE --out o/c.ply": CALIBRATIONS,
    "reconstruct my_session --calibration calibration.yaml --limits FILE --out o/c.ply": "limits.yaml",
    "compare FILE part.stl": CLOUDS,
    "compare cloud.ply FILE": MESHES,
    "compare cloud.ply part.stl --calibration FILE": CALIBRATIONS,
    "convert FILE --out o/c.yaml": "opencv.yml opencv.xml opencv.json",
    "import FILE --plan plan.yaml --projector-size 912 1140 --lattice diamond --out o/s": "",
    "import my_images --plan FILE --out o/s": "",
    "characterise FILE --target target.yaml --out o/c.yaml": "my_session my_poses",
    "characterise my_poses --target FILE --out o/c.yaml": "target.yaml",
    "characterise my_poses --target target.yaml --limits FILE --out o/c.yaml": "limits.yaml",
    f"characterise --points FILE --target target.yaml {SIZES} --out o/c.yaml": "points.csv",
    "characterise --judge FILE my_poses": CALIBRATIONS,
    "check --rig FILE": RIGS,
    "check --rig rig.yaml --calibration FILE": CALIBRATIONS,
    "gamma --rig FILE --out o/r.yaml": RIGS,
    "gamma --rig rig.yaml --plan FILE --out o/r.yaml": PLANS,
    "decode FILE --out o/d.npz": SESSIONS,
    "export FILE --out o/x.csv": "",
    "view FILE --out o/v.rrd": SESSIONS,
    "view my_session --mesh FILE --out o/v.rrd": MESHES,
    "view my_session --calibration FILE --out o/v.rrd": CALIBRATIONS,
    "target FILE --out o/t.pdf": "target.yaml",
    "plan show FILE --rig rig.yaml": PLANS,
    "plan show plan.yaml --rig FILE": RIGS,
    "plan guess FILE --projector-size 912 1140 --out o/p.yaml": "",
    "report FILE cloud.ply --out o/r.html": "my_session cloud.ply",
    "verify --standard FILE --spheres cloud.ply --out o/v.html": "standard.yaml",
    "verify --standard standard.yaml --spheres FILE --out o/v.html": "",
    "verify --standard standard.yaml --spheres cloud.ply --calibration FILE --out o/v.html": CALIBRATIONS,
    "optimise stripes --rig FILE --out o/p.yaml": RIGS,
    "optimise stripes --rig rig.yaml --study FILE --out o/p.yaml": "study.yaml",
    "optimise stripes --rig rig.yaml --study study.yaml --calibration FILE --out o/p.yaml": CALIBRATIONS,
    "predict --rig FILE --plan plan.yaml --item pyramid": RIGS,
    "predict --rig rig.yaml --plan FILE --item pyramid": PLANS,
    "predict --rig rig.yaml --plan plan.yaml --item pyramid --calibration FILE": CALIBRATIONS,
    "match --twin FILE --reference my_poses --out o/m": RIGS,
    "match --twin rig.yaml --reference FILE --out o/m": "my_session my_poses",
    "match --twin rig.yaml --reference my_poses --gamma FILE --out o/m": "",
    "compare-rigs FILE --rig rig.yaml --item pyramid --calibration calibration.yaml": SESSIONS,
    "dataset --rig FILE --count 1 --out o/d": RIGS,
    "dataset --rig rig.yaml --scenes FILE --count 1 --out o/d": "dataset.yaml",
    "twin record --rig FILE --out o/t": RIGS,
    "session info FILE": SESSIONS,
    "session repair FILE": SESSIONS,
    "live --rig FILE": RIGS,
}
"""Command lines, and the files for FILE with which they would begin their work."""

program: Any = get_command(app)


def say(words: Sequence[str]) -> str:
    """The exit code and the sentence that answer a command line, in this process."""
    out = io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
            program.main(list(words), prog_name="fpplab", standalone_mode=False)
    except FppError as error:
        answer = f"{error.exit_code} {error}"
        return answer.replace(os.getcwd() + os.sep, "").replace(f"{ROOT}{os.sep}", "")
    except SystemExit as error:
        return f"{error.code} {' '.join(out.getvalue().split())[-200:]}"
    except Exception as error:  # noqa: BLE001 - each is a fault of fpplab, and told as such
        return f"1 {type(error).__name__}: {error}"
    return "0"


def cells(names: Sequence[str], lines: Iterable[str] = ARGUMENTS) -> Cells:
    """What is said of files in the working directory."""
    said: Cells = {"kinds": {name: str(describe_file(Path(name))) for name in names}}
    for line in lines:
        for name in names:
            if name in ARGUMENTS[line].split():
                continue
            shutil.rmtree("o", ignore_errors=True)
            answer = say([name if word == "FILE" else word for word in line.split()])
            answer = answer.replace(name, "FILE")
            answer = answer.replace(f"FILE: is {said['kinds'][name]};", "FILE: is KIND;")
            said.setdefault(line, {})[name] = answer
    return said


def grouped(said: Cells) -> dict[str, dict[str, str]]:
    """The files of which the same is said, by what that is."""
    table: dict[str, dict[str, str]] = {}
    for line, by_name in said.items():
        answers: dict[str, list[str]] = {}
        for name, answer in by_name.items():
            answers.setdefault(answer, []).append(name)
        table[line] = {answer: " ".join(sorted(names)) for answer, names in sorted(answers.items())}
    return table


def reviewed() -> Cells:
    """The table as it was reviewed by hand."""
    table = yaml.safe_load(TABLE.read_text(encoding="utf-8"))
    return {
        line: {name: answer for answer, names in answers.items() for name in names.split()}
        for line, answers in table.items()
    }


def main(write: bool) -> None:
    """Print the table, or replace the reviewed one."""
    logging.disable(logging.CRITICAL)
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        table = grouped(cells(make_files(Path(folder))))
    text = yaml.safe_dump(table, sort_keys=False, width=10_000, allow_unicode=True)
    if write:
        TABLE.write_text(text, encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main("--write" in sys.argv)
