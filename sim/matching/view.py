"""A matching as it goes: images of bench and twin with their difference, the loss by epoch, both devices."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.viewer import layouts
from fpplab.viewer.canvas import CommandView, subsample_columns
from fpplab.viewer.colours import ColourScale
from fpplab.viewer.measurement import show_devices
from fpplab.viewer.viewer import Viewer
from sim.matching.page import loss_curve
from sim.matching.record import MatchingEpoch
from sim.matching.reference import Reference
from sim.twin import Twin

CURVES = {
    "loss": ("loss, whole image", (51, 120, 184)),
    "loss_board": ("loss, over the board", (222, 130, 48)),
    "ssim": ("SSIM, whole image", (51, 120, 184)),
    "ssim_board": ("SSIM, over the board", (222, 130, 48)),
    "epsilon_d_px": ("ε_d in px", (122, 171, 89)),
    "difference": ("RMS difference over the board in raw levels", (200, 84, 110)),
}
"""By the key of an epoch's figures: the curve's name and RGB."""


class MatchingView(CommandView):
    """Images on the left, curves on the right; the timeline is `epoch`."""

    def arrange_views(self) -> None:
        import rerun.blueprint as rrb

        self._epochs: list[MatchingEpoch] = []
        self.canvas.directions("world")
        for key, (name, colour) in CURVES.items():
            self.canvas.curve_style(f"match/{key}", name, colour)
        images = rrb.Grid(
            layouts.image("Bench", "/images/bench"),
            layouts.image("Twin", "/images/twin"),
            layouts.image("Bench less twin", "/images/difference"),
            layouts.scene("Rig and boards", ["/world/**"]),
            grid_columns=2,
        )
        curves = rrb.Vertical(
            layouts.image("Loss by epoch", "/diagrams/loss"),
            layouts.curves("SSIM", ["/match/ssim", "/match/ssim_board"]),
            layouts.curves("ε_d in px", ["/match/epsilon_d_px"]),
            layouts.text_view("Epoch", "/words/epoch"),
            row_shares=[3, 2, 2, 2],
        )
        self.canvas.arrange(rrb.Horizontal(images, curves, column_shares=[5, 4]))

    def epoch(self, epoch: MatchingEpoch) -> None:
        """Show an epoch: the twin's devices and boards, and the loss with its parts."""
        self._epochs.append(epoch)
        self.canvas.at("epoch", epoch.epoch)
        figures = {**epoch.loss, "difference": epoch.difference}
        for key in CURVES:
            self.canvas.value(f"match/{key}", figures[key])
        parameters = epoch.parameters.parameters()
        show_devices(self.canvas, parameters.calibration)
        places = np.array([board.translation for board in parameters.poses])
        self.canvas.cloud("world/boards", places, np.full((len(places), 3), 220, np.uint8))
        self.canvas.open_on("rig", "world/boards", places)
        if "loss_spread" in epoch.loss:
            self.canvas.figure("diagrams/loss", loss_curve(self._epochs))
        kept = "kept" if epoch.accepted else "taken back"
        self.canvas.text(
            "words/epoch",
            f"**Epoch {epoch.epoch}**, step *{epoch.step}*: {kept}\n\n"
            f"loss {epoch.loss['loss']:.4f}, over the board {epoch.loss['loss_board']:.4f}; "
            f"SSIM {epoch.loss['ssim']:.4f}, over the board {epoch.loss['ssim_board']:.4f}; "
            f"ε_d {epoch.loss['epsilon_d_px']:.4f} px; difference {epoch.difference:.2f} raw levels RMS; "
            f"{epoch.seconds:.0f} s",
            static=False,
        )

    def images(self, bench: NDArray[np.float32], twin: NDArray[np.float32]) -> None:
        """Show the same image of the bench and of the twin as the latest epoch left it."""
        bright = max(float(np.percentile(bench, 99.8)), 1.0)
        grey = ColourScale("Raw level", "", "gray", 0.0, bright)
        limit = max(float(np.percentile(np.abs(bench - twin), 99.5)), 1.0)
        self.canvas.map("images/bench", bench, grey)
        self.canvas.map("images/twin", twin, grey)
        signed = ColourScale("Bench less twin", "raw levels", "RdBu_r", -limit, limit)
        self.canvas.map("images/difference", bench - twin, signed)


def show_twin(viewer: Viewer[MatchingView], reference: Reference, twin: Twin) -> None:
    pose, images = reference.spread_poses(1)[0], reference.finest[:1]
    expected: Any = twin.expected(pose, reference.shown(images), reference.settings)[0]
    real: Any = reference.frames(pose, images)[0]
    bench, own = (np.asarray(subsample_columns(np.asarray(image)), np.float32) for image in (real, expected))
    viewer.show(MatchingView.images, bench, own)
