"""A freeform part: fringes bend over it, and the errors are as large as stated.

Written to a name that ends in `.webp`, the picture shows the scan while it runs.
"""

import io
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from bench import measured, plan_of, plt
from matplotlib.colors import LightSource
from numpy.typing import NDArray
from PIL import Image

from fpplab import Calibration, Cloud, Session, decode
from fpplab.reconstruction.points import triangulate

X_MM, Y_MM, DEPTH_MM = 55.0, 40.0, 455.0


def freeform() -> trimesh.Trimesh:
    """Hills and valleys of some 25 mm on a block of 110 x 80 mm, in the camera's frame."""
    n = 181
    x, y = np.meshgrid(np.linspace(-3, 3, n), np.linspace(-3, 3, n))
    hills = 3 * (1 - x) ** 2 * np.exp(-(x**2) - (y + 1) ** 2) - np.exp(-((x + 1) ** 2) - y**2) / 3
    hills -= 10 * (x / 5 - x**3 - y**5) * np.exp(-(x**2) - y**2)
    top = np.stack([x * X_MM / 3, y * Y_MM / 3, DEPTH_MM - 1.7 * hills], -1).reshape(-1, 3)
    base = np.column_stack([top[:, :2], np.full(n * n, DEPTH_MM + 30.0)])
    index = np.arange(n * n).reshape(n, n)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    faces = np.concatenate([np.stack([a, c, b], 1), np.stack([b, c, d], 1)])
    border = np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
    after = np.roll(border, -1)
    walls = np.concatenate(
        [np.stack([border, after, border + n * n], 1), np.stack([after, after + n * n, border + n * n], 1)]
    )
    block = trimesh.Trimesh(
        np.concatenate([top, base]), np.concatenate([faces, faces[:, ::-1] + n * n, walls])
    )
    trimesh.repair.fix_normals(block)
    return block


def heights(cloud: Cloud, top_mm: float) -> NDArray[np.float64]:
    """Height of each pixel's point below `top_mm`, in mm; NaN where there is none."""
    return top_mm - cloud.map_of("z")


def shaded(height_mm: NDArray[np.float64]) -> NDArray[np.float64]:
    """A picture of a surface in the light of a lamp; white where there are no points."""
    lit = LightSource(315, 40).shade(
        np.nan_to_num(height_mm), plt.get_cmap("viridis"), None, "soft", 0, 25, dx=0.25, dy=0.25
    )
    lit[np.isnan(height_mm)] = 1.0
    return lit


def still(path: str) -> None:
    """A camera image and the surface, above the errors."""
    figure = plt.figure(figsize=(8.6, 7.6), layout="constrained")
    left, middle, right = (figure.add_subplot(place) for place in (221, 222, 212))
    left.imshow(scan.frames[-1], cmap="gray", vmin=0, vmax=255)
    left.set_title("camera image")
    middle.imshow(shaded(surface))
    middle.set_title(f"surface, {np.nanmax(surface):.0f} mm high")
    shown = right.imshow(scan.error_um, cmap="RdBu_r", vmin=-30, vmax=30)
    figure.colorbar(shown, ax=right, label="µm above the surface")
    right.set_title(f"error, {100 * inside:.0f} % in their 95 % interval")
    for axis in (left, middle, right):
        axis.axis("off")
        axis.set(xlim=scan.columns, ylim=scan.rows[::-1])
    figure.savefig(path, dpi=120)


def animated(path: str) -> None:
    """Frame by frame, with the surface by the fringe sets that are complete; the result comes first."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(7.2, 3.1), layout="constrained")
    pictures, durations_ms = [], []

    def draw(frame: Any, image: Any, titles: tuple[str, str], duration_ms: int) -> None:
        for axis, shown, title in zip((left, right), (frame, image), titles, strict=True):
            axis.clear()
            axis.imshow(shown, cmap="gray", vmin=0, vmax=255)
            axis.set_title(title)
            axis.axis("off")
            axis.set(xlim=scan.columns, ylim=scan.rows[::-1])
        figure.savefig(file := io.BytesIO(), dpi=100)
        pictures.append(Image.open(file).convert("RGB"))
        durations_ms.append(duration_ms)

    last = scan.frames[-1]
    verdict = f"{scan.diagnosis.verdict}: {len(scan.cloud.points):,} points"
    draw(last, shaded(surface), ("18 images", verdict), 2500)
    image = np.ones((*surface.shape, 3))
    for number, fringes in enumerate(recording.plan.fringes):
        for step in range(fringes.steps):
            frame = scan.frames[number * fringes.steps + step]
            titles = (
                f"fringe set {number + 1}, image {step + 1} of 6",
                "surface so far" if number else "no surface yet",
            )
            draw(frame, image, titles, 160)
        if number < 2:
            done = replace(
                recording,
                plan=plan_of(tuple(s.stripes for s in recording.plan.fringes[: number + 1])),
                frames=recording.frames[: (number + 1) * fringes.steps],
            )
            image = shaded(heights(triangulate(decode(done), calibration), top_mm))
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=durations_ms, quality=80)


with tempfile.TemporaryDirectory() as place:
    scan = measured(Path(place), item="freeform", shape=freeform(), verified=True)
    recording = Session.open(Path(place) / "scan").recording()
    calibration = Calibration.load(Path(place) / "scan" / "calibration.yaml")
stated = np.full(scan.error_um.shape, np.nan)
column, row = scan.cloud.pixels.T
stated[row, column] = 1e3 * np.hypot(scan.cloud.sigma_noise_mm, scan.cloud.sigma_phase_error_mm)
inside = np.mean(np.abs(scan.error_um / stated)[np.isfinite(stated)] < 1.96)
top_mm = scan.cloud.points[:, 2].max()
surface = heights(scan.cloud, top_mm)
(animated if sys.argv[1].endswith(".webp") else still)(sys.argv[1])
print(scan.diagnosis.sentence)
