"""A characterisation as it goes: the frames of its poses, then boards, devices and residuals."""

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
        import rerun.blueprint as rrb

        devices = [f"/{CAMERA}/**", f"/{PROJECTOR}/**", f"/{REACH['rig']}"]
        rig = layouts.scene("Rig and boards", [*devices, f"/{BOARDS}"])
        boards = layouts.scene("Boards", [f"/{BOARDS}", f"/{REACH['part']}"])
        tabs = [layouts.with_bar(view, f"/bars/{BOARDS}", view.name) for view in (rig, boards)]
        return rrb.Tabs(*tabs, active_tab=0, name="Scene")

    def pictures(self) -> list[Any]:
        return [
            *super().pictures()[:3],
            layouts.text_view("Result", "/words/result"),
            layouts.image("Camera residuals", "/diagrams/camera"),
            layouts.image("Projector residuals", "/diagrams/projector"),
        ]

    def result(self, characterisation: Characterisation) -> None:
        self.calibration(characterisation.calibration)
        points, errors = [], []
        for pose, observation, residuals in zip(
            characterisation.poses,
            characterisation.observations,
            characterisation.camera_residuals,
            strict=True,
        ):
            points.append(pose.apply(characterisation.board[observation.ids]))
            errors.append(np.linalg.norm(residuals, axis=1))
        error = np.concatenate(errors)
        scale = ColourScale(
            "Reprojection error in the camera", "px", "magma", 0.0, float(np.percentile(error, 98))
        )
        self.canvas.cloud(BOARDS, np.concatenate(points), scale.colours_of(error))
        self.canvas.open_on("rig", BOARDS, np.concatenate(points))
        self.canvas.open_on("part", BOARDS, np.concatenate(points))
        self.canvas.bar(f"bars/{BOARDS}", scale)
        for device, seen in characterisation.by_device.items():
            pixels, residuals = np.concatenate(seen.pixels), np.concatenate(seen.residuals)
            drawn = residuals_figure(pixels, residuals, seen.size, device)
            self.canvas.figure(f"diagrams/{device}", drawn, static=True)
        rows = "\n".join(f"| {key} | {value} |" for key, value in characterisation.facts().items())
        self.canvas.text("words/result", f"| | |\n|---|---|\n{rows}")
