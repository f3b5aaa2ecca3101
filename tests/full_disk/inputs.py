"""Every command that writes, on data as small as they allow."""

import shutil
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial import Delaunay

from benchmarks.crash.programs import (
    DATASET,
    IMPORT,
    MATCH,
    OPTIMISE,
    SCAN,
    UPLOAD,
    DisturbedProgram,
    prepare,
)
from fpplab.clouds import load_cloud
from tests.full_disk.every_write import WritingCommand
from tests.support.commands import run


def prepare_inputs(folder: Path) -> None:
    """Write what the commands read: rigs, plans, images, poses, a scan, and a mesh of its cloud."""
    prepare(folder, (IMPORT, MATCH, UPLOAD))
    done = run(*_words(SCAN, "scan"), cwd=folder)
    assert done.code == 0, done.err
    points = load_cloud(folder / "scan" / "cloud.ply").points[::50]
    mesh = trimesh.Trimesh(points, Delaunay(points[:, :2].astype(np.float64)).simplices[:, ::-1])
    mesh.export(folder / "surface.stl")


def a_scan(inputs: Path, out: Path) -> None:
    """A copy of the scan."""
    shutil.copytree(inputs / "scan", out)


def a_damaged_scan(inputs: Path, out: Path) -> None:
    """A copy of the scan with two frames, the plan and a result damaged."""
    a_scan(inputs, out)
    frames = sorted((out / "frames").iterdir())
    for file in (frames[1], frames[4], out / "plan.yaml", out / "decoded.npz"):
        content = file.read_bytes()
        file.write_bytes(content[:-3] + b"xyz")


def _words(program: DisturbedProgram, out: str) -> list[str]:
    return program.words.format(out=out).split()[2:]


def _of(program: DisturbedProgram) -> WritingCommand:
    """A command of the crash benchmark."""
    return WritingCommand(program.name, program.words.partition("fpplab ")[2], program.suffix)


EVERY_COMMAND = (
    _of(SCAN),
    _of(IMPORT),
    _of(DATASET),
    _of(MATCH),
    _of(OPTIMISE),
    WritingCommand("characterise", "characterise poses --target target_paper --out {out}", ".yaml"),
    WritingCommand(
        "gamma", "gamma --rig rig.yaml --plan plan.yaml --levels 5 --repeats 1 --out {out}", ".yaml"
    ),
    WritingCommand("decode", "decode scan --out {out}", ".npz"),
    WritingCommand("reconstruct", "reconstruct scan --calibration calibration.yaml --out {out}", ".ply"),
    WritingCommand("compare", "compare scan/cloud.ply surface.stl --report {out}", ".html"),
    WritingCommand("report", "report scan poses/pose_00 --out {out}", ".html"),
    WritingCommand("repair", "session repair {out}", begin=a_damaged_scan, mends=True),
    WritingCommand("bug-report", "bug-report scan --out {out}", ".zip"),
    WritingCommand("plan show", "plan show plan.yaml --rig rig.yaml --out {out}", ".png"),
    WritingCommand("target", "target target_paper --out {out}", ".pdf"),
    WritingCommand("convert", "convert calibration.yaml --out {out}", ".yml"),
    WritingCommand("export", "export scan/cloud.ply --out {out}", ".csv"),
    WritingCommand("artefact", "artefact pyramid --out {out}", ".stl"),
    WritingCommand("build", "dlp4500 build plan.yaml --base maker.bin --out {out}", ".bin"),
)
