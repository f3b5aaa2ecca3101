"""A simulated rig as the Blender extension shows it, and as a .blend file."""

import math
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fpplab.core.conventions import Axis
from fpplab.core.errors import ConfigError, DataError, DeviceError
from fpplab.core.files import replace_file, write_atomic
from fpplab.devices.backends import load_backend
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets import stepped_fringes
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from sim.bench import VirtualBench
from sim.build import SceneState
from sim.items import item_poses
from sim.preview_file import Preview, write_preview
from sim.sensor import SensorModel
from sim.worker import START_S, missing_library
from sim.world import World


@dataclass(frozen=True)
class Arrangement:
    """What is placed before the devices, where the projector is, and what it shows."""

    item: str | None = None  # name of the item; None for the one that the world has mounted
    pose: int = 0  # index of its pose
    baseline_mm: float | None = None  # distance of the projector from the camera in mm
    axis: Axis = "x"  # along which the fringes' phase rises
    stripes: float = 64.0  # periods across the projector's image
    steps: int = 12  # images of the phase shift
    exposure_s: float = 0.02  # of every frame, in s

    def fringes(self) -> Plan:
        return self._plan([self.stripes])

    def plan(self) -> Plan:
        """Make the plan of a scan: the fringes on show, and coarser ones to find their orders."""
        # A fringe set has at most eight times the stripes of the one before.
        ratios = max(1, math.ceil(math.log(max(self.stripes, 1.0), 8.0) - 1e-9))
        counts = [self.stripes ** (n / ratios) for n in range(ratios + 1)]
        return self._plan(counts if self.stripes > 1 else [self.stripes])

    def _plan(self, counts: list[float]) -> Plan:
        sets = tuple(stepped_fringes(self.axis, count, self.steps) for count in counts)
        return Plan(fringes=sets, exposure_s=self.exposure_s)


def load_simulated_rig(path: str) -> Rig:
    """Load a rig, but refuse one of real or emulated devices before any of them is opened."""
    rig = Rig.load(path)
    bench = rig.file.bench
    if bench is None or not issubclass(load_backend(bench.backend, rig.source, "bench"), VirtualBench):
        raise ConfigError(
            f"{rig.source}: is not simulated, so there is no scene to show; match a twin to it "
            "(`fpplab match`) and name the twin's rig.yaml"
        )
    return rig


def bench_of_rig(rig: Rig) -> VirtualBench:
    assert isinstance(rig.simulation, VirtualBench), "see load_simulated_rig"
    return rig.simulation


def make_preview(rig: Rig, arrangement: Arrangement, step: int = 0) -> Preview:
    """Describe what the camera of a simulated rig sees."""
    bench, plan = bench_of_rig(rig), arrangement.fringes()
    world, setup = bench.world, arranged_setup(bench.world, arrangement)
    if not 0 <= step < arrangement.steps:
        raise ConfigError(
            f"step {step}: must be 0 to {arrangement.steps - 1}, for there are {arrangement.steps} steps"
        )
    caps = rig.projector.caps
    patterns = rig.projector.load(make_patterns(plan, caps.size, caps.lattice))
    settings = rig.camera_settings(plan.exposure_s)
    return Preview(
        rig=rig.file.name,
        shown=(
            f"{setup.item}, {arrangement.stripes:g} stripes along {arrangement.axis}, "
            f"step {step} of {arrangement.steps}"
        ),
        render=bench.light.pattern_render(setup, patterns[step]),
        grey_scale=SensorModel.of(world).grey_scale(settings),
    )


def save_preview(rig: Rig, arrangement: Arrangement, step: int, path: Path) -> None:
    preview = make_preview(rig, arrangement, step)
    write_atomic(path, lambda stream: write_preview(preview, stream))


def stage_for_baseline(world: World, baseline_mm: float | None) -> float:
    """Compute where the stage has the projector at a distance from the camera."""
    if baseline_mm is None:
        return 0.0
    at_zero = world.T_projector_camera().inverse().translation
    along = float(at_zero @ world.stage.offset(1.0))
    across_squared = float(at_zero @ at_zero) - along**2
    root = math.sqrt(max(baseline_mm**2 - across_squared, 0.0))
    position = round(math.copysign(root, along) - along, 6)
    low, high = world.stage.travel_mm
    if baseline_mm**2 < across_squared or not low <= position <= high:
        ends = baseline_range_mm(world)
        raise ConfigError(
            f"baseline {baseline_mm:g} mm: the stage reaches {ends[0]:.1f} to {ends[1]:.1f} mm "
            f"('stage.travel_mm' is {low:g} to {high:g})"
        )
    return position


def baseline_range_mm(world: World) -> tuple[float, float]:
    at_zero = world.T_projector_camera().inverse().translation
    low, high = world.stage.travel_mm
    nearest = float(np.clip(-float(at_zero @ world.stage.offset(1.0)), low, high))
    shortest, *ends = (float(np.linalg.norm(at_zero + world.stage.offset(mm))) for mm in (nearest, low, high))
    return shortest, max(ends)


def arrangement_summary(rig: Rig, arrangement: Arrangement) -> dict[str, object]:
    """Give what was arranged, and between what an operator can choose."""
    world = bench_of_rig(rig).world
    setup = arranged_setup(world, arrangement)
    return {
        "rig": rig.file.name,
        "item": setup.item,
        "items": list(world.items),
        "poses": len(item_poses(world, setup.item)),
        "baseline_mm": float(np.linalg.norm(setup.T_projector_camera(world).inverse().translation)),
        "baseline_range_mm": list(baseline_range_mm(world)),
        "size": list(world.camera.size),
    }


def arranged_setup(world: World, arrangement: Arrangement) -> SceneState:
    item = world.mounted if arrangement.item is None else arrangement.item
    if item == "nothing":
        raise ConfigError(f"world: nothing is mounted; name an item of {', '.join(world.items)}")
    poses = len(item_poses(world, item))
    if not 0 <= arrangement.pose < poses:
        raise ConfigError(f"pose {arrangement.pose}: '{item}' has the poses 0 to {poses - 1}")
    return replace(
        SceneState(item, arrangement.pose), stage_mm=stage_for_baseline(world, arrangement.baseline_mm)
    )


def export_preview(preview: Preview, out: Path) -> None:
    """Write a preview as a .blend file that needs no other file."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}-") as folder:
            described, made = Path(folder) / "preview.npz", Path(folder) / "scene.blend"
            with described.open("wb") as stream:
                write_preview(preview, stream)
            _run_blender(described, made)
            replace_file(made, out)
    except OSError as error:
        raise DataError(f"{out}: cannot be written ({error.strerror})") from error


def _run_blender(described: Path, made: Path) -> None:
    command = [sys.executable, "-P", "-m", f"{__package__}.blender.export", str(described), str(made)]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    doing = ("Blender", "export")
    try:
        done = subprocess.run(
            command,
            env=environment,
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=START_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise DeviceError(*doing, f"no file within {START_S:.0f} s", "run the command again") from error
    said = (done.stderr + done.stdout).strip()
    if missing := missing_library(said):
        raise DeviceError(*doing, *missing)
    if done.returncode or not made.is_file():
        last = said.splitlines()[-1] if said else "no output"
        raise DeviceError(*doing, f"Blender has failed ({last})", "see the world file")
