"""A characterisation as it goes: the frames of its poses, then boards, devices and residuals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fpplab.characterisation import Characterisation
from fpplab.report.figures import residuals_figure
from fpplab.viewer import layouts
from fpplab.viewer.canvas import REACH
from fpplab.viewer.colours import ColourScale
from fpplab.viewer.measurement import CAMERA, PROJECTOR, Colouring, MeasurementView

BOARDS = "world/boards"


class CharacterisationView(MeasurementView):
    """Boards with both devices on the left, frames and residuals on the right."""

    def scenes(self, colourings: Sequence[Colouring] = ()) -> Any:
        """Lay out the boards in space with the colour bar of their errors."""
        import rerun.blueprint as rrb

        devices = [f"/{CAMERA}/**", f"/{PROJECTOR}/**", f"/{REACH['rig']}"]
        rig = layouts.scene("Rig and boards", [*devices, f"/{BOARDS}"])
        boards = layouts.scene("Boards", [f"/{BOARDS}", f"/{REACH['part']}"])
        tabs = [layouts.with_bar(one, f"/bars/{BOARDS}", one.name) for one in (rig, boards)]
        return rrb.Tabs(*tabs, active_tab=0, name="Scene")

    def pictures(self) -> list[Any]:
        """List the views of images, residuals and words."""
        return [
            *super().pictures()[:3],
            layouts.words("Result", "/words/result"),
            layouts.image("Camera residuals", "/diagrams/camera"),
            layouts.image("Projector residuals", "/diagrams/projector"),
        ]

    def result(self, found: Characterisation) -> None:
        """Show the devices, every board coloured by its points' errors, and the residuals."""
        self.calibration(found.calibration)
        points, errors = [], []
        for pose, seen, residuals in zip(
            found.poses, found.observations, found.camera_residuals, strict=True
        ):
            points.append(pose.apply(found.board[seen.ids]))
            errors.append(np.linalg.norm(residuals, axis=1))
        error = np.concatenate(errors)
        scale = ColourScale(
            "Reprojection error in the camera", "px", "magma", 0.0, float(np.percentile(error, 98))
        )
        self.canvas.cloud(BOARDS, np.concatenate(points), scale.colours_of(error))
        self.canvas.open_on("rig", BOARDS, np.concatenate(points))
        self.canvas.open_on("part", BOARDS, np.concatenate(points))
        self.canvas.bar(f"bars/{BOARDS}", scale)
        both = (
            ("camera", [o.camera_px for o in found.observations], found.camera_residuals),
            ("projector", [o.projector_px for o in found.observations], found.projector_residuals),
        )
        for device, pixels, residual in both:
            size = getattr(found.calibration, device).size
            drawn = residuals_figure(np.concatenate(pixels), np.concatenate(residual), size, device)
            self.canvas.figure(f"diagrams/{device}", drawn, static=True)
        rows = "\n".join(f"| {key} | {value} |" for key, value in found.facts().items())
        self.canvas.text("words/result", f"| | |\n|---|---|\n{rows}")
