"""The set-up as it goes: the image, red where it is saturated and blue where it stays dark; focus."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Image, Mask, full_scale
from fpplab.devices import Frame
from fpplab.patterns.fringes import Pattern
from fpplab.setup.live.expectation import RigGeometry
from fpplab.setup.live.exposure import LightLevels
from fpplab.setup.live.focus import FocusMeasure, FocusTracker
from fpplab.setup.live.regions import REGIONS
from fpplab.setup.live.status import LiveStatus
from fpplab.viewer import layouts
from fpplab.viewer.canvas import REACH, CommandView, eight_bits, shown_step, subsample_columns
from fpplab.viewer.measurement import CAMERA, IMAGE, PATTERN, PROJECTOR, show_devices
from fpplab.viewer.viewer import Viewer

SATURATED, DARK = (255, 48, 32), (24, 60, 150)  # RGB of pixels at full scale, and of those that stay dark

UNKNOWN_FOCUS = (72, 76, 82)  # RGB of a region whose focus is not known

OVERLAP_COLOUR, WORKING_COLOUR = (90, 170, 110), (250, 200, 60)
"""RGB of the fields' overlap, and of that at the working distance."""

CURVES = {
    "focus/camera": ("camera", (51, 120, 184)),
    "focus/projector": ("projector", (222, 130, 48)),
    "light/peak": ("peak", (122, 171, 89)),
    "light/saturated": ("saturated pixels", (200, 84, 110)),
}


@dataclass(frozen=True, eq=False)
class LitImage:
    """A camera image as it is sent to be shown, with what is saturated or dark in it."""

    grey: NDArray[np.uint8]  # upper eight bits of every n-th pixel
    saturated: Mask  # where one of the pixels that this one stands for is at full scale
    dark: Mask | None  # where it stays dark in the projector's light

    @classmethod
    def of(cls, image: Image, bits: int, dark: Mask | None) -> LitImage:
        """Reduce an image to what is shown of it; no saturated pixel is lost by that."""
        # image (height, width); dark (height, width)
        step = shown_step(image.shape[1])
        grey = eight_bits(image[::step, ::step], bits)
        saturated = np.zeros(grey.shape, np.bool_)
        v, u = np.nonzero(image >= full_scale(bits))
        saturated[v // step, u // step] = True
        return cls(grey, saturated, None if dark is None else subsample_columns(dark).copy())

    def painted(self) -> NDArray[np.uint8]:
        # returns (rows, columns, 3)
        rgb = np.repeat(self.grey[..., None], 3, axis=2)
        if self.dark is not None:
            rgb[self.dark] = rgb[self.dark] // 2 + np.array(DARK, np.uint8) // 2
        rgb[self.saturated] = SATURATED
        return rgb


@dataclass(frozen=True, eq=False)
class LiveSnapshot:
    """What is shown of the set-up after a frame."""

    number: int  # of the frame
    image: LitImage  # what the camera sees
    pattern: NDArray[np.uint8]  # what the projector shows, subsampled
    pattern_id: str  # shows whether the pattern has changed
    focus: dict[str, FocusTracker]  # by device, where it was measured with this frame
    levels: LightLevels | None  # light, where it was measured with this frame
    state_text: str  # the state in Markdown


class LiveView(CommandView):
    """The image large, pattern or scene and histogram below it, and the measures at the side."""

    def arrange_views(self) -> None:
        self._pattern_id = self._state_text = ""
        for entity, (name, colour) in CURVES.items():
            self.canvas.curve_style(entity, name, colour)
        self.canvas.arrange(self.arrangement(layouts.image("Projector", f"/{PATTERN}")))

    def arrangement(self, below: Any) -> Any:
        import rerun.blueprint as rrb

        camera = layouts.image("Camera: red saturated, blue dark", f"/{IMAGE}")
        histogram = rrb.BarChartView(origin="/light/histogram", name="Histogram (log), black to full scale")
        maps = [
            layouts.image(f"Focus of the {name}, % of best", f"/maps/{name}_focus")
            for name in ("camera", "projector")
        ]
        focus = rrb.TimeSeriesView(
            origin="/focus",
            name="Focus, % of best",
            axis_y=rrb.ScalarAxis(range=(0.0, 105.0), zoom_lock=True),
        )
        light = layouts.curves("Light, %", ["/light/peak", "/light/saturated"])
        measures = rrb.Vertical(
            rrb.Horizontal(focus, light), *maps, layouts.text_view("State", "/words"), row_shares=[3, 4, 4, 3]
        )
        return rrb.Horizontal(
            rrb.Vertical(camera, rrb.Horizontal(below, histogram), row_shares=[3, 2]),
            measures,
            column_shares=[3, 2],
        )

    def scene(self, geometry: RigGeometry, distance_mm: float | None) -> None:
        self.canvas.directions("world")
        show_devices(self.canvas, geometry.calibration)
        self._draw_overlap(geometry, distance_mm)
        contents = [
            f"/{CAMERA}/**",
            f"/{PROJECTOR}/**",
            f"/{REACH['rig']}",
            "/world/overlap",
            "/world/working",
        ]
        scene = layouts.scene("Scene: overlap green, working distance yellow", contents)
        self.canvas.arrange(self.arrangement(scene))

    def _draw_overlap(self, geometry: RigGeometry, distance_mm: float | None) -> None:
        import rerun as rr

        near, far = geometry.depth_mm
        outlines = [geometry.outline(float(d)) for d in np.linspace(near, far, 7)]
        strips = [outline for outline in outlines if len(outline)]
        overlap = rr.LineStrips3D(strips, colors=OVERLAP_COLOUR, radii=rr.Radius.ui_points(1.0))
        self.canvas.log("world/overlap", overlap, static=True)
        if strips:
            self.canvas.open_on("rig", "overlap", np.concatenate(strips))
        if distance_mm is not None and len(at_distance := geometry.outline(distance_mm)):
            working = rr.LineStrips3D([at_distance], colors=WORKING_COLOUR, radii=rr.Radius.ui_points(2.0))
            self.canvas.log("world/working", working, static=True)

    def snapshot(self, now: LiveSnapshot) -> None:
        import rerun as rr

        self.canvas.at("frame", now.number)
        self.canvas.picture(IMAGE, now.image.painted())
        counts = np.bincount(now.image.grey.ravel() // 4, minlength=64)  # 64 bins
        self.canvas.log("light/histogram", rr.BarChart(np.log10(1.0 + counts)))
        if now.pattern_id != self._pattern_id:
            self._pattern_id = now.pattern_id
            self.canvas.picture(PATTERN, now.pattern)
        for name, shares in now.focus.items():
            self._draw_focus(name, shares)
        if now.levels is not None:
            self.canvas.value("light/peak", 100.0 * now.levels.peak)
            self.canvas.value("light/saturated", 100.0 * now.levels.saturated)
        if now.state_text != self._state_text:
            self._state_text = now.state_text
            self.canvas.text("words", now.state_text, static=False)

    def _draw_focus(self, name: str, focus: FocusTracker, cell_px: int = 40) -> None:
        import rerun as rr

        if focus.share is not None:
            self.canvas.value(f"focus/{name}", 100.0 * focus.share)
        measured = np.isfinite(focus.shares)
        table = mpl.colormaps["RdYlGn"](np.clip(np.nan_to_num(focus.shares), 0.0, 1.0))[..., :3]
        rgb = np.rint(200 * table).astype(np.uint8)
        rgb[~measured] = UNKNOWN_FOCUS
        entity = f"maps/{name}_focus"
        self.canvas.log(entity, rr.Image(rgb.repeat(cell_px, axis=0).repeat(cell_px, axis=1)))
        v, u = np.meshgrid(*((np.arange(n) + 0.5) * cell_px for n in REGIONS), indexing="ij")
        labels = [f"{100 * share:.0f}" if share == share else "–" for share in focus.shares.ravel()]
        centres = np.stack([u.ravel(), v.ravel()], axis=1)
        points = rr.Points2D(centres, labels=labels, show_labels=True, radii=0.0, colors=(255, 255, 255))
        self.canvas.log(f"{entity}/share", points)


class LiveFrames:
    """Sends frames of the set-up to a viewer, with what was measured since the one before."""

    # Browsers fall behind with more than ten frames a second.
    def __init__(self, viewer: Viewer[LiveView], max_rate_hz: float = 10.0) -> None:
        self._viewer, self._max_rate_hz = viewer, max_rate_hz
        self._last_s = -math.inf
        self._levels: LightLevels | None = None
        self._focus: dict[str, FocusMeasure] = {}

    def show(self, status: LiveStatus, frame: Frame, pattern: Pattern, dark: Mask | None) -> None:
        # dark (height, width)
        now = time.monotonic()
        if now - self._last_s < 1.0 / self._max_rate_hz:
            return
        self._last_s = now
        levels = None if status.levels is self._levels else status.levels
        self._levels = status.levels
        snapshot = LiveSnapshot(
            number=status.frames,
            image=LitImage.of(frame.image, frame.settings.bits, dark),
            pattern=subsample_columns(pattern.image),
            pattern_id=pattern.id,
            focus=self._focus_measured(status),
            levels=levels,
            state_text=_state_text(status),
        )
        self._viewer.show_one_of_many(LiveView.snapshot, snapshot)

    def _focus_measured(self, status: LiveStatus) -> dict[str, FocusTracker]:
        trackers: dict[str, FocusTracker] = {
            "camera": status.camera_focus,
            "projector": status.projector_focus,
        }
        new = {
            name: tracker for name, tracker in trackers.items() if tracker.now is not self._focus.get(name)
        }
        self._focus |= {name: tracker.now for name, tracker in new.items()}
        return new


def _state_text(status: LiveStatus) -> str:
    lines = [status.line().replace(" | ", "  \n")]
    if status.advice is not None:
        lines += [f"**{limit}**" for limit in status.advice.limits]
    lines += [f"**{finding.cause}**: {finding.evidence}; {finding.remedy}" for finding in status.findings]
    return "\n\n".join(lines)
