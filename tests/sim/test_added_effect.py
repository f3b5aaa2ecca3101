"""An effect of the twin is one file: a copy of `sim` with one more file has it everywhere."""

import os
import subprocess
import sys
from pathlib import Path
from shutil import copytree

import pytest

from tests.sim.conftest import plain, write_world

ROOT = Path(__file__).parents[2]
DRIFT = """
from dataclasses import dataclass, field

from fpplab.core.config import Document
from sim.effects.base import Effect, LightChange
from sim.parameter_entry import table_entry


class DriftField(Document):
    drift: float = 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class DriftParameter:
    projector_drift: float = field(
        default=0.0, metadata=table_entry("Change per frame, relative.", "projector.drift")
    )


class Drift(Effect):
    name = "drift"
    explains = "light of the projector that changes slowly"
    order = 100
    parameters = DriftParameter
    strength = ("projector_drift",)
    projector_fields = DriftField

    def clear(self, data):
        data["projector"]["drift"] = 0.0

    def changes_light(self, world):
        return world.projector.drift != 0

    def light_change(self, world, frame, rows, random):
        return LightChange(projector=1.0 + world.projector.drift * frame.number)
"""
USE = """
import sys
from dataclasses import replace

import numpy as np
import pytest

import sim
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import uniform_patterns
from sim.bench import VirtualBench
from sim.devices import SimCamera, SimFixture, SimProjector
from sim.matching.page import parameter_comparison
from sim.matching.record import ParametersFile
from sim.matching.steps import EXPLAINS
from sim.parameters import TABLE
from sim.world import World

folder, file = sys.argv[1:]
assert sim.__file__.startswith(folder)
assert World.load(file).projector.drift == -0.1
bench = VirtualBench({"world": file, "analytic": True})
devices = camera, projector, fixture = [
    kind(name, {}, bench)
    for kind, name in ((SimCamera, "camera"), (SimProjector, "projector"), (SimFixture, "fixture"))
]
bench.open()
for device in devices:
    device.open()
fixture.mount("card")
projector.load(uniform_patterns([255], projector.caps.size))
projector.show(0)
camera.configure(CameraSettings(0.02, bits=12))
black = 0.01 * 4095
levels = np.array([camera.snap().image.mean() - black for _ in range(3)])
assert levels / levels[0] == pytest.approx([1.0, 0.9, 0.8], abs=0.01)

twin = bench.twin("board")
assert TABLE["projector_drift"].path == "projector.drift"
assert twin.parameters.projector_drift == -0.1
steady = twin.with_parameters(replace(twin.parameters, projector_drift=0.0))
assert steady.world.projector.drift == 0.0
assert ParametersFile.of(twin.parameters).projector_drift == -0.1
rows = parameter_comparison(steady.parameters, twin.parameters)
assert ("projector_drift", "0", "-0.1", "") in rows
assert EXPLAINS["drift"] == "light of the projector that changes slowly"
for device in devices:
    device.close()
bench.close()
"""


@pytest.mark.whole
def test_an_effect_is_one_file(tmp_path: Path) -> None:
    copytree(ROOT / "sim", tmp_path / "sim")
    (tmp_path / "sim" / "effects" / "drift.py").write_text(DRIFT)
    file = write_world(tmp_path, plain(projector={"drift": -0.1}))
    (tmp_path / "use.py").write_text(USE)
    paths = [str(tmp_path), str(ROOT), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [sys.executable, "use.py", str(tmp_path), file],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
