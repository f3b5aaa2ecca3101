"""Kinds of boards: a module in the package of kinds is all that a new kind needs."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import fpplab

SHIFTED = '''
from fpplab.targets.kinds.circles import CircleGrid


class ShiftedCircles(CircleGrid):
    """Circles whose odd columns lie lower by a part of the pitch that the file gives."""

    shift: float

    def offsets(self, column, row):
        placed = super().offsets(column, row)
        placed[..., 1] += self.shift * self.spacing_mm[1] * (column % 2)
        return placed
'''

USE = """
import numpy as np
from fpplab.core import config
from fpplab.core.errors import ConfigError
from fpplab.targets import Target

fields = {"kind": "shifted", "size_mm": [60, 42], "counts": [13, 4], "spacing_mm": [4.5, 9], "diameter_mm": 3}
target = config.validate({**fields, "shift": 0.1}, Target, "board.yaml")
print(round(target.points()[1, 1] - target.points()[0, 1], 6))
print(len(target.detect(np.pad(target.image(8.0), 40, constant_values=90)).ids))
print("shift: 0.1" in config.dump(target))
for changes in ({}, {"kind": "circles", "shift": 0.1}, {"kind": "stars"}):
    try:
        config.validate({**fields, **changes}, Target, "board.yaml")
    except ConfigError as error:
        print(error)
"""


@pytest.mark.whole
def test_a_module_in_the_package_is_a_kind_of_target_file(tmp_path: Path) -> None:
    shutil.copytree(Path(fpplab.__file__).parent, tmp_path / "fpplab")
    (tmp_path / "fpplab/targets/kinds/shifted.py").write_text(SHIFTED)
    done = subprocess.run(
        [sys.executable, "-c", USE], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == [
        "0.9",
        "52",
        "True",
        "board.yaml: 'shift' is missing; kind shifted needs it",
        "board.yaml: 'shift' belongs to kind shifted, not to circles",
        "board.yaml: 'kind' is 'stars': should be 'shifted', 'marks', 'circles', 'checkerboard' or "
        "'charuco'; did you mean 'marks'?",
    ]
