"""The set-up in the viewer: the image with what is saturated or dark painted in, histogram, focus, the scene.

Red is saturated, blue stays dark in the projector's light. The timeline `frame` counts the frames.
"""

from __future__ import annotations

import math
import time
from typing import Any

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Image, Mask, full_scale
from fpplab.devices import Frame
from fpplab.live.expectation import RigGeometry
from fpplab.live.exposure import LightLevels
from fpplab.live.focus import FocusMeasure, FocusTracker
from fpplab.live.regions import REGIONS
from fpplab.live.status import LiveStatus
from fpplab.patterns.fringes import Pattern
from fpplab.report.viewer import Viewer

SATURATED, DARK = (255, 48, 32), (24, 60, 150)
"""RGB of pixels at full scale, and of those that stay dark."""

UNKNOWN_FOCUS = (72, 76, 82)
"""RGB of a region whose focus is not known."""

SHOWN_COLUMNS = 1400
"""Columns beyond which the image is reduced before it is sent."""

CELL_PX = 40
"""Side of a region in the maps, in px."""

BINS = 64
"""Bins of the histogram."""

MOST_HZ = 15.0
"""Most frames per s that are sent to a browser, which would fall behind with more."""

SLICES = 7
"""Planes of the depth range in which the overlap of both fields is drawn."""

OVERLAP_COLOUR, WORKING_COLOUR = (90, 170, 110), (250, 200, 60)
"""RGB of the fields' overlap, and of that at the working distance."""


class LiveViewer:
    """Shows the set-up in a viewer; a `LiveObserver` but for what it tells.

    Parameters
    ----------
    viewer : Viewer
        Open; it may have failed.
    geometry : RigGeometry, optional
        For the scene, with a calibration.
    distance_mm : float, optional
        The working distance, in mm.
    """

    def __init__(
        self, viewer: Viewer, geometry: RigGeometry | None = None, distance_mm: float | None = None
    ) -> None:
        self._viewer = viewer
        self._most_hz = MOST_HZ if viewer.where.startswith("http") else math.inf
        self._last_s = -math.inf
        self._pattern: Pattern | None = None
        self._levels: LightLevels | None = None
        self._focus: dict[str, FocusMeasure] = {}
        self._said = ""
        viewer.draw(lambda stream: stream.send_blueprint(_layout(geometry is not None)))
        if geometry is not None:
            viewer.calibration(geometry.calibration)
            viewer.draw(lambda stream: _draw_overlap(stream, geometry, distance_mm))

    def show(self, status: LiveStatus, frame: Frame, pattern: Pattern, dark: Mask | None) -> None:
        """Show a frame with the state after it; a frame that comes too soon is left out.

        Parameters
        ----------
        status : LiveStatus
            The snapshot.
        frame : Frame
            The frame.
        pattern : Pattern
            What it shows.
        dark : ndarray of bool, (height, width), or None
            Pixels that stay dark in the view's light.
        """
        now = time.monotonic()
        if now - self._last_s < 1.0 / self._most_hz:
            return
        self._last_s = now
        self._viewer.draw(lambda stream: self._draw(stream, status, frame, pattern, dark))

    def _draw(
        self, stream: Any, status: LiveStatus, frame: Frame, pattern: Pattern, dark: Mask | None
    ) -> None:
        stream.set_time("frame", sequence=status.frames)
        _draw_image(stream, frame, dark)
        if pattern is not self._pattern:
            self._pattern = pattern
            _draw_pattern(stream, pattern)
        for name, tracker in (("camera", status.camera_focus), ("projector", status.projector_focus)):
            if tracker.now is not self._focus.get(name):
                self._focus[name] = tracker.now
                _draw_focus(stream, name, tracker)
        if status.levels is not self._levels and status.levels is not None:
            self._levels = status.levels
            _draw_levels(stream, status.levels)
        if (words := _words(status)) != self._said:
            self._said = words
            _draw_words(stream, words)


def painted(image: Image, bits: int, dark: Mask | None) -> NDArray[np.uint8]:
    """Paint what is saturated or dark into a camera image.

    Parameters
    ----------
    image : ndarray of uint8 or uint16, (height, width)
        Raw levels.
    bits : int
        Their depth.
    dark : ndarray of bool, (height, width), or None
        Pixels that count as dark.

    Returns
    -------
    ndarray of uint8, (rows, columns, 3)
        RGB, reduced to `SHOWN_COLUMNS`; a saturated pixel is never lost by that.
    """
    step = max(1, -(-image.shape[1] // SHOWN_COLUMNS))
    grey = (image[::step, ::step] >> (bits - 8)).astype(np.uint8)
    rgb = np.repeat(grey[..., None], 3, axis=2)
    if dark is not None:
        hidden = dark[::step, ::step]
        rgb[hidden] = rgb[hidden] // 2 + np.array(DARK, np.uint8) // 2
    v, u = np.nonzero(image >= full_scale(bits))
    rgb[v // step, u // step] = SATURATED
    return rgb


def _draw_image(stream: Any, frame: Frame, dark: Mask | None) -> None:
    import rerun as rr

    bits = frame.settings.bits
    stream.log("world/camera/image", rr.Image(painted(frame.image, bits, dark)).compress(jpeg_quality=85))
    counts, _ = np.histogram(frame.image[::2, ::2], BINS, (0, full_scale(bits) + 1))
    stream.log("light/histogram", rr.BarChart(np.log10(1.0 + counts)))


def _draw_pattern(stream: Any, pattern: Pattern) -> None:
    import rerun as rr

    shown = np.ascontiguousarray(pattern.image[::2, ::2])
    stream.log("world/projector/pattern", rr.Image(shown).compress(jpeg_quality=70))


def _draw_levels(stream: Any, levels: LightLevels) -> None:
    import rerun as rr

    stream.log("light/peak", rr.Scalars(100.0 * levels.peak))
    stream.log("light/saturated", rr.Scalars(100.0 * levels.saturated))


def _draw_words(stream: Any, words: str) -> None:
    import rerun as rr

    stream.log("words", rr.TextDocument(words, media_type=rr.MediaType.MARKDOWN))


def _draw_focus(stream: Any, name: str, tracker: FocusTracker) -> None:
    import rerun as rr

    if tracker.share is not None:
        stream.log(f"focus/{name}", rr.Scalars(100.0 * tracker.share))
    _draw_map(stream, f"maps/{name}_focus", tracker)


def _draw_map(stream: Any, entity: str, tracker: FocusTracker) -> None:
    """The focus of each region as a share of its best: colours, and figures on them."""
    import rerun as rr

    shares = tracker.shares
    known = np.isfinite(shares)
    table = mpl.colormaps["RdYlGn"](np.clip(np.nan_to_num(shares), 0.0, 1.0))[..., :3]
    rgb = np.rint(200 * table).astype(np.uint8)
    rgb[~known] = UNKNOWN_FOCUS
    stream.log(entity, rr.Image(rgb.repeat(CELL_PX, axis=0).repeat(CELL_PX, axis=1)))
    v, u = np.meshgrid(*((np.arange(n) + 0.5) * CELL_PX for n in REGIONS), indexing="ij")
    labels = [f"{100 * share:.0f}" if share == share else "–" for share in shares.ravel()]
    centres = np.stack([u.ravel(), v.ravel()], axis=1)
    points = rr.Points2D(centres, labels=labels, show_labels=True, radii=0.0, colors=(255, 255, 255))
    stream.log(f"{entity}/share", points)


def _draw_overlap(stream: Any, geometry: RigGeometry, distance_mm: float | None) -> None:
    """The part of space that both devices see, plane by plane, and its part at the working distance."""
    import rerun as rr

    near, far = geometry.depth_mm
    outlines = [geometry.outline(float(d)) for d in np.linspace(near, far, SLICES)]
    strips = [one for one in outlines if len(one)]
    stream.log(
        "world/overlap",
        rr.LineStrips3D(strips, colors=OVERLAP_COLOUR, radii=rr.Radius.ui_points(1.0)),
        static=True,
    )
    if distance_mm is not None and len(here := geometry.outline(distance_mm)):
        working = rr.LineStrips3D([here], colors=WORKING_COLOUR, radii=rr.Radius.ui_points(2.0))
        stream.log("world/working", working, static=True)


def _words(status: LiveStatus) -> str:
    """The state in Markdown."""
    lines = [status.line().replace(" | ", "  \n")]
    if status.advice is not None:
        lines += [f"**{one}**" for one in status.advice.limits]
    lines += [f"**{one.cause}**: {one.evidence}; {one.remedy}" for one in status.findings]
    return "\n\n".join(lines)


def _layout(with_scene: bool) -> Any:
    """The image large, the scene below it, and the measures at the side."""
    import rerun.blueprint as rrb

    background = (28, 30, 34)
    camera = rrb.Spatial2DView(
        origin="/world/camera/image", name="Camera: red saturated, blue dark", background=background
    )
    pattern = rrb.Spatial2DView(origin="/world/projector/pattern", name="Projector", background=background)
    maps = [
        rrb.Spatial2DView(
            origin=f"/maps/{name}_focus", name=f"Focus of the {name}, % of best", background=background
        )
        for name in ("camera", "projector")
    ]
    focus = rrb.TimeSeriesView(
        origin="/focus", name="Focus, % of best", axis_y=rrb.ScalarAxis(range=(0.0, 105.0), zoom_lock=True)
    )
    histogram = rrb.BarChartView(origin="/light/histogram", name="Histogram (log), black to full scale")
    words = rrb.TextDocumentView(origin="/words", name="State")
    scene = rrb.Spatial3DView(
        origin="/world",
        name="Scene: overlap green, working distance yellow",
        background=background,
        line_grid=rrb.archetypes.LineGrid3D(visible=False),
    )
    below = rrb.Horizontal(scene, histogram) if with_scene else rrb.Horizontal(pattern, histogram)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(camera, below, row_shares=[3, 2]),
            rrb.Vertical(focus, *maps, words, row_shares=[3, 4, 4, 3]),
            column_shares=[3, 2],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed"),
    )
