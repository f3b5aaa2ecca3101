"""A preview as a .blend file, written by a Blender process."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from fpplab.core.errors import DataError, DeviceError
from sim.preview_file import Preview, write_preview
from sim.worker import START_S, missing_library


def export_preview(preview: Preview, out: Path) -> None:
    """Write a preview as a .blend file that needs no other file."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}-") as folder:
            described, made = Path(folder) / "preview.npz", Path(folder) / "scene.blend"
            with described.open("wb") as stream:
                write_preview(preview, stream)
            _run_blender(described, made)
            made.replace(out)
    except OSError as error:
        raise DataError(f"{out}: cannot be written ({error.strerror})") from error


def _run_blender(described: Path, made: Path) -> None:
    command = [sys.executable, "-P", "-m", f"{__package__}.blender.export", str(described), str(made)]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    doing = ("Blender", "export")
    try:
        done = subprocess.run(
            command, env=environment, capture_output=True, text=True, timeout=START_S, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise DeviceError(*doing, f"no file within {START_S:.0f} s", "run the command again") from error
    said = (done.stderr + done.stdout).strip()
    if missing := missing_library(said):
        raise DeviceError(*doing, *missing)
    if done.returncode or not made.is_file():
        last = said.splitlines()[-1] if said else "no output"
        raise DeviceError(*doing, f"Blender has failed ({last})", "see the world file")
