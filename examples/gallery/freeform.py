"""A freeform part: fringes bend over it, and the errors are as large as stated."""

import sys
import tempfile
from pathlib import Path

import numpy as np
import trimesh
from bench import measured, plt
from matplotlib.colors import LightSource

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


with tempfile.TemporaryDirectory() as place:
    scan = measured(Path(place), item="freeform", shape=freeform(), verified=True)
stated = np.full(scan.error_um.shape, np.nan)
column, row = scan.cloud.pixels.T
stated[row, column] = 1e3 * np.hypot(scan.cloud.sigma_noise_mm, scan.cloud.sigma_phase_error_mm)
inside = np.mean(np.abs(scan.error_um / stated)[np.isfinite(stated)] < 1.96)

surface = np.zeros(scan.error_um.shape)
surface[row, column] = scan.cloud.points[:, 2].max() - scan.cloud.points[:, 2]
shaded = LightSource(315, 40).shade(surface, plt.get_cmap("viridis"), None, "soft", dx=0.25, dy=0.25)
shaded[np.isnan(scan.error_um)] = 1.0

figure = plt.figure(figsize=(8.6, 7.6), layout="constrained")
left, middle, right = (figure.add_subplot(place) for place in (221, 222, 212))
left.imshow(scan.frames[-1], cmap="gray", vmin=0, vmax=255)
left.set_title("camera image")
middle.imshow(shaded)
middle.set_title(f"surface, {surface.max():.0f} mm high")
shown = right.imshow(scan.error_um, cmap="RdBu_r", vmin=-30, vmax=30)
figure.colorbar(shown, ax=right, label="µm")
right.set_title(f"error, {100 * inside:.0f} % in their 95 % interval")
for axis in (left, middle, right):
    axis.axis("off")
    axis.set(xlim=scan.columns, ylim=scan.rows[::-1])
figure.savefig(sys.argv[1], dpi=120)
print(scan.diagnosis.sentence)
