"""A camera and a projector as a table, and as a drawing from above."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.core.notebook import axes_or_new, html_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def calibration_table(
    devices: Mapping[str, Pinhole], baseline_mm: float, rms_px: Mapping[str, float], has_uncertainty: bool
) -> str:
    """Write what a calibration says as a table for notebooks."""
    rows: dict[str, object] = {}
    for name, device in devices.items():
        fx, fy, cx, cy = device.matrix[[0, 1, 0, 1], [0, 1, 2, 2]]
        width, height = device.size
        rows[name] = f"{width} x {height} px, f {fx:.1f}, {fy:.1f} px, c {cx:.1f}, {cy:.1f} px"
        rows[f"{name} distortion"] = ", ".join(f"{value:.4g}" for value in device.distortion) or None
    rows["lattice"] = str(devices["projector"].lattice)
    rows["baseline"] = f"{baseline_mm:.2f} mm"
    rows |= {f"{name} RMS": f"{value:.3g} px" for name, value in rms_px.items()}
    rows["uncertainty"] = "known" if has_uncertainty else "unknown"
    return html_table("Calibration", rows)


def draw_from_above(
    devices: Mapping[str, Pinhole], T_projector_camera: RigidTransform, reach_mm: float, axes: Axes | None
) -> Axes:
    chosen = axes_or_new(axes)
    poses = {"camera": RigidTransform.identity(), "projector": T_projector_camera.inverse()}
    for name, device in devices.items():
        width, height = device.size
        row = (height - 1) / 2
        ends = np.array([[-0.5, row], [width - 0.5, row]])
        rays = reach_mm * np.c_[device.normalise(ends), np.ones(2)]
        field = poses[name].apply(np.array([rays[0], np.zeros(3), rays[1]]))
        (line,) = chosen.plot(field[:, 0], field[:, 2], label=name)
        chosen.fill(field[:, 0], field[:, 2], color=line.get_color(), alpha=0.15)
    chosen.set(xlabel="x, mm", ylabel="z, mm", aspect="equal")
    chosen.legend()
    return chosen
