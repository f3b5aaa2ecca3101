"""A calibration as a table, and as a drawing from above."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from fpplab.core.geometry import RigidTransform
from fpplab.core.notebook import axes_or_new, html_table

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from fpplab.calibration.model import Calibration


def calibration_table(calibration: Calibration) -> str:
    """Write what a calibration says as a table for notebooks."""
    rows: dict[str, object] = {}
    for name, one in (("camera", calibration.camera), ("projector", calibration.projector)):
        fx, fy, cx, cy = one.matrix[0, 0], one.matrix[1, 1], one.matrix[0, 2], one.matrix[1, 2]
        rows[name] = f"{one.size[0]} x {one.size[1]} px, f {fx:.1f}, {fy:.1f} px, c {cx:.1f}, {cy:.1f} px"
        rows[f"{name} distortion"] = ", ".join(f"{value:.4g}" for value in one.distortion) or None
    rows["lattice"] = str(calibration.projector.lattice)
    rows["baseline"] = f"{calibration.baseline_mm:.2f} mm"
    rows |= {f"{name} RMS": f"{value:.3g} px" for name, value in calibration.rms_px.items()}
    rows["uncertainty"] = "known" if calibration.uncertainty else "unknown"
    return html_table("Calibration", rows)


def draw_from_above(calibration: Calibration, reach_mm: float, axes: Axes | None) -> Axes:
    """Draw camera and projector from above, with what each of them sees."""
    chosen = axes_or_new(axes)
    poses = {"camera": RigidTransform.identity(), "projector": calibration.T_projector_camera.inverse()}
    for name, one in (("camera", calibration.camera), ("projector", calibration.projector)):
        width, height = one.size
        row = (height - 1) / 2
        ends = np.array([[-0.5, row], [width - 0.5, row]])
        rays = reach_mm * np.c_[one.normalise(ends), np.ones(2)]
        field = poses[name].apply(np.array([rays[0], np.zeros(3), rays[1]]))
        (line,) = chosen.plot(field[:, 0], field[:, 2], label=name)
        chosen.fill(field[:, 0], field[:, 2], color=line.get_color(), alpha=0.15)
    chosen.set(xlabel="x, mm", ylabel="z, mm", aspect="equal")
    chosen.legend()
    return chosen
