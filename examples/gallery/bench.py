"""What the scripts of the gallery share: the virtual bench with something changed, measured and drawn."""

import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import trimesh
import yaml

from fpplab import Calibration, Cloud, Plan, Rig, Session, decode, load_cloud, scan
from fpplab.calibration.model import CalibrationOrigin
from fpplab.diagnosis import Diagnosis, UselessScanError
from fpplab.diagnosis.record import load_diagnosis
from fpplab.pipeline.true_maps import trace_true_maps

mpl.use("Agg")
from matplotlib import pyplot as plt

CONFIGS = Path(__file__).parents[2] / "configs"
RIG = {
    "name": "Gallery",
    "bench": {"backend": "virtual_bench", "world": "world.yaml"},
    "camera": {"backend": "virtual_camera", "bits": 8},
    "projector": {"backend": "virtual_projector"},
    "fixture": {"backend": "virtual_fixture"},
}
STILL = {"rotation_deg": [0, 0, 0], "translation_mm": [0, 0, 0]}
mpl.rcParams |= {"font.size": 18, "axes.titlesize": 18}  # 10 px where a phone shows the picture 358 px wide


def merged(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """A mapping with the values of another one, level by level."""
    both = dict(one)
    for key, value in other.items():
        inner = isinstance(value, Mapping) and isinstance(both.get(key), Mapping)
        both[key] = merged(both[key], value) if inner else value
    return both


def plan_of(stripes: tuple[float, ...] = (1, 8, 64), steps: int = 6, **more: Any) -> Plan:
    """A plan of fringes along the baseline."""
    fringes = tuple({"axis": "x", "stripes": float(one), "steps": steps} for one in stripes)
    return Plan.model_validate({"fringes": fringes, "exposure_s": 0.02, "filter": {}, **more})


@dataclass(frozen=True)
class Measured:
    """One scan of the gallery: frames, coordinates, points or none, their errors, what is shown.

    `error_um` is how far points are in front of the true surface, seen from the camera, in µm.
    """

    frames: Any
    coordinate: Any
    cloud: Cloud | None
    error_um: Any
    diagnosis: Diagnosis
    rows: tuple[int, int]
    columns: tuple[int, int]


def show(
    world: Mapping[str, Any] | None = None, plan: Plan | None = None, limit_um: float = 30.0, **more: Any
) -> None:
    """Measure as `measured` does, and draw a frame, the errors and the verdict into `sys.argv[1]`."""
    with tempfile.TemporaryDirectory() as place:
        draw(measured(Path(place), world, plan, **more), limit_um)


def measured(
    folder: Path,
    world: Mapping[str, Any] | None = None,
    plan: Plan | None = None,
    item: str = "pyramid",
    shape: trimesh.Trimesh | None = None,
    moved: Mapping[str, Any] | None = None,
    verified: bool = False,
) -> Measured:
    """Measure an item on the changed bench.

    `world` is what differs from the demonstration's world file, `shape` a further item in the camera's frame,
    `moved` what changes after the calibration, `verified` whether a board has just confirmed the calibration.
    """
    base = yaml.safe_load((CONFIGS / "world_demo.yaml").read_text(encoding="utf-8"))
    changed = merged(merged(base, {"camera": {"binning": 8}}), world or {})
    rig_file = RIG | ({"geometry": {"max_age_h": 1}} if verified else {})
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig_file), encoding="utf-8")
    if shape is not None:
        shape.export(folder / "shape.stl")
        changed["items"][item] = {"mesh": "shape.stl", "pose": STILL}
    surface, calibration = truth_of(folder, changed, item)
    save(folder, merged(changed, moved or {}))
    if verified:
        calibration = replace(calibration, origin=CalibrationOrigin.now(poses_taken=datetime.now(UTC)))
    with Rig.load(folder / "rig.yaml") as rig, suppress(UselessScanError):
        scan(rig, plan or plan_of(), calibration, folder / "scan", (item, 0), report=False)
    recording = Session.open(folder / "scan").recording()
    coordinate = decode(recording).u
    cloud, error_um = None, np.full(coordinate.shape, np.nan)
    if (folder / "scan" / "cloud.ply").is_file():
        cloud = load_cloud(folder / "scan" / "cloud.ply")
        column, row = cloud.pixels.T
        depth = trace_true_maps(surface, calibration).depth
        error_um[row, column] = 1e3 * (depth[row, column] - cloud.points[:, 2])
    frames = [np.asarray(frame) for frame in recording.frames]
    diagnosis = load_diagnosis(folder / "scan").diagnosis()
    return Measured(frames, coordinate, cloud, error_um, diagnosis, *part_in(frames))


def save(folder: Path, world: Mapping[str, Any]) -> None:
    """Write the world file, with the boards that it names found in `configs`."""
    text = yaml.safe_dump(dict(world)).replace("target_paper.yaml", str(CONFIGS / "target_paper.yaml"))
    (folder / "world.yaml").write_text(text, encoding="utf-8")


def truth_of(folder: Path, world: Mapping[str, Any], item: str) -> tuple[trimesh.Trimesh, Calibration]:
    """The true surface of an item, and the exact calibration of the bench."""
    save(folder, world)
    with Rig.load(folder / "rig.yaml") as rig:
        sampler = rig.simulation.image_part_sampler()  # type: ignore[union-attr]
        return sampler.mesh(item), sampler.calibration


def part_in(frames: Any) -> tuple[tuple[int, int], tuple[int, int]]:
    """First and last row and column of what changes with the fringes, with a margin."""
    changes = np.ptp(np.stack([np.asarray(frame, float) for frame in frames]), axis=0)
    found = changes > 0.3 * np.quantile(changes, 0.99)
    rows, columns = (np.flatnonzero(np.mean(found, axis=axis) > 0.05) for axis in (1, 0))
    return (rows[0] - 15, rows[-1] + 15), (columns[0] - 15, columns[-1] + 15)


def draw(scan: Measured, limit_um: float) -> None:
    """A frame and what was decoded, side by side above the error, under the verdict."""
    figure = plt.figure(figsize=(8.6, 8.2), layout="constrained")
    left, middle, right = (figure.add_subplot(place) for place in (221, 222, 212))
    left.imshow(scan.frames[-1], cmap="gray", vmin=0, vmax=255)
    left.set_title("last frame")
    middle.imshow(scan.coordinate)
    middle.set_title("decoded coordinate")
    if scan.cloud:
        right.set_title(f"error, median {np.nanmedian(np.abs(scan.error_um)):.0f} µm")
        shown = right.imshow(scan.error_um, cmap="RdBu_r", vmin=-limit_um, vmax=limit_um)
        figure.colorbar(shown, ax=right, label="µm above the surface")
    else:
        for axis in (middle, right) if np.isnan(scan.coordinate).all() else (right,):
            axis.text(0.5, 0.5, "no points", transform=axis.transAxes, ha="center", va="center")
    for axis in (left, middle, right):
        axis.axis("off")
        axis.set(xlim=scan.columns, ylim=scan.rows[::-1])
    causes = ", ".join(finding.cause.key for finding in scan.diagnosis.findings)
    figure.suptitle(f"{scan.diagnosis.verdict}{': ' + causes if causes else ''}", fontweight="bold")
    figure.savefig(sys.argv[1], dpi=80)
    print(scan.diagnosis.sentence)
