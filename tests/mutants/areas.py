"""What the mutation test covers, and the faults it draws."""

import hashlib
from collections.abc import Sequence
from pathlib import Path

from tests.mutants.seeding import Mutant, mutants

AREAS = {
    "core": ("fpplab/core/*.py",),
    "sessions": ("fpplab/sessions/*.py",),
    "acquisition": ("fpplab/acquisition/*.py", "fpplab/setup/*.py", "fpplab/setup/rig_check/*.py"),
    "phase": ("fpplab/phase/*.py",),
    "characterisation": ("fpplab/characterisation/*.py",),
    "uncertainty": (
        "fpplab/reconstruction/uncertainty.py",
        "fpplab/calibration/displacements.py",
        *(f"fpplab/phase/{name}.py" for name in ("bounds", "common_errors", "error_model", "noise")),
        "fpplab/phase/precision.py",
    ),
    "reconstruction": ("fpplab/reconstruction/*.py", "fpplab/clouds/*.py"),
    "comparison": ("fpplab/comparison/*.py",),
    "drivers": ("drivers/**/*.py",),
    "sim": ("sim/*.py", "sim/light/*.py", "sim/world/*.py"),
}
"""Files by area. Of the twin, the code inside Blender's own process is left to the tests that render."""


def files_of(root: Path, area: str) -> list[str]:
    """Paths of an area's files, relative to the root."""
    found = {path.relative_to(root).as_posix() for glob in AREAS[area] for path in root.glob(glob)}
    if area != "uncertainty":
        found -= set(AREAS["uncertainty"])
    return sorted(found)


def draw(root: Path, each: int, seed: int, areas: Sequence[str]) -> list[Mutant]:
    """Draw faults at random: so many of every area, taking turns between them, each of a line of its own.

    A fault of an area may stand in any of its files, each place with the same chance. While other code
    changes, what is drawn stays drawn, unless faults of the new code come before it.
    """
    drawn: list[list[Mutant]] = []
    for area in areas:
        found = [mutant for file in files_of(root, area) for mutant in mutants(root, file)]
        every = sorted(found, key=lambda mutant: _lot(f"{seed} {area} {mutant.name}"))
        lines = {(mutant.file, mutant.line): mutant for mutant in reversed(every)}
        drawn.append([mutant for mutant in every if lines[mutant.file, mutant.line] is mutant][:each])
    return [mutant for turn in zip(*drawn, strict=True) for mutant in turn]


def _lot(words: str) -> bytes:
    """A random number that is the same for the same words."""
    return hashlib.sha256(words.encode()).digest()
