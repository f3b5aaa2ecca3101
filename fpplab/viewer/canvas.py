"""What all views draw with: pictures, maps with their colour bars, curves, points, devices."""

import math
import os
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Image, Map
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.viewer.colours import ColourScale

SHOWN_COLUMNS = 1600  # columns beyond which an image or map is subsampled before it is shown (chosen)
MAX_POINTS = 300_000  # points beyond which a cloud is thinned before it is shown (chosen)
MAX_RECORDING_BYTES = 128 * 2**20  # beyond which no more images of single frames are kept (chosen)
BACKGROUND = (38, 41, 46)
Opened = Literal["rig", "part"]  # scenes of the rig with all that is around it, and scenes of the part alone
REACH: dict[Opened, str] = {"rig": "world/reach/rig", "part": "world/reach/part"}
"""Entities of invisible points, which make scenes open with all of their content in view."""

Scalar = TypeVar("Scalar", bound=np.generic)


class Canvas:
    """Streams of rerun that are drawn on; used in a `with` block, which completes them."""

    def __init__(self, send: Callable[[bytes], object] | None = None, file: Path | None = None) -> None:
        os.environ.setdefault("RUST_LOG", "off")  # rerun prints what its errors say anyway
        import rerun

        self._rr: Any = rerun
        rerun.set_strict_mode(True)
        self._live = rerun.RecordingStream("fpplab") if send else None
        self._kept = rerun.RecordingStream("fpplab") if file else None
        self._send = send
        self._unsent = rerun.binary_stream(self._live) if self._live else None
        if self._kept and file:
            self._kept.save(file)
        self._bytes = 0
        self._there: dict[Opened, dict[str, Floats]] = {"rig": {}, "part": {}}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.pass_on()
        for stream in self._streams:
            stream.flush()  # waits until all is out
            stream.disconnect()
        self._live = self._kept = None

    @property
    def _streams(self) -> tuple[Any, ...]:
        return tuple(stream for stream in (self._live, self._kept) if stream is not None)

    def pass_on(self) -> None:
        if self._live and self._send and self._unsent:
            self._send(self._unsent.read(flush=True) or b"")

    def leave_server(self) -> None:
        live, self._live = self._live, None
        if live is not None:
            live.disconnect()

    def arrange(self, views: Any) -> None:
        import rerun.blueprint as rrb

        plan = rrb.Blueprint(
            views,
            rrb.BlueprintPanel(state="collapsed"),
            rrb.SelectionPanel(state="collapsed"),
            rrb.TimePanel(state="collapsed"),
        )
        for stream in self._streams:
            stream.send_blueprint(plan)

    def at(self, timeline: str, number: int) -> None:
        for stream in self._streams:
            stream.set_time(timeline, sequence=number)

    def log(self, entity: str, archetype: Any, *, static: bool = False, bulky: bool = False) -> None:
        if self._live:
            self._live.log(entity, archetype, static=static)
        if self._kept and not (bulky and self._bytes > MAX_RECORDING_BYTES):
            self._kept.log(entity, archetype, static=static)

    def picture(self, entity: str, pixels: NDArray[np.uint8]) -> None:
        # pixels (h, w)
        packed = self._rr.Image(np.ascontiguousarray(pixels)).compress(jpeg_quality=90)
        self._bytes += pixels.size // 8
        self.log(entity, packed, bulky=True)

    def map(self, entity: str, values: Map, scale: ColourScale, *, static: bool = False) -> None:
        # values (h, w)
        sheet = scale.above_its_bar(subsample_columns(values))
        self._bytes += sheet.nbytes
        self.log(entity, self._rr.Image(sheet), static=static, bulky=not static)

    def figure(self, entity: str, png: bytes, *, static: bool = False) -> None:
        self._bytes += len(png)
        packed = self._rr.EncodedImage(contents=png, media_type="image/png")
        self.log(entity, packed, static=static, bulky=not static)

    def bar(self, entity: str, scale: ColourScale) -> None:
        self.log(entity, self._rr.Image(scale.bar()), static=True)

    def cloud(self, entity: str, points: NDArray[np.floating[Any]], colours: NDArray[np.uint8]) -> None:
        # points (N, 3) mm; colours (N, 3)
        step = max(1, math.ceil(len(points) / MAX_POINTS))
        shown = self._rr.Points3D(
            points[::step], colors=colours[::step], radii=self._rr.Radius.ui_points(1.2)
        )
        self.log(entity, shown, static=True)

    def value(self, entity: str, value: float) -> None:
        self.log(entity, self._rr.Scalars(value))

    def curve_style(self, entity: str, name: str, colour: tuple[int, int, int]) -> None:
        self.log(entity, self._rr.SeriesLines(names=name, colors=colour, widths=2.0), static=True)

    def text(self, entity: str, markdown: str, *, static: bool = True) -> None:
        self.log(entity, self._rr.TextDocument(markdown, media_type="text/markdown"), static=static)

    def device(self, entity: str, device: Pinhole, T_world_device: RigidTransform, reach_mm: float) -> None:
        # Pinholes are drawn without distortion, so the edge of an image may differ from the cloud's.
        step = shown_step(device.size[0])
        matrix = device.matrix.copy()
        matrix[:2, 2] += 0.5  # rerun counts from the corner of the first pixel, not from its centre
        matrix[:2] /= step  # the images are shown with every n-th pixel
        pose = self._rr.Transform3D(translation=T_world_device.translation, mat3x3=T_world_device.rotation)
        model = self._rr.Pinhole(
            image_from_camera=matrix,
            resolution=[-(-n // step) for n in device.size],
            camera_xyz=self._rr.ViewCoordinates.RDF,
            image_plane_distance=reach_mm,
        )
        self.log(entity, pose, static=True)
        self.log(entity, model, static=True)
        corners = np.array([[x, y] for x in (0, device.size[0]) for y in (0, device.size[1])], np.float64)
        rays = np.column_stack([corners, np.ones(4)]) @ np.linalg.inv(device.matrix).T
        self.open_on("rig", entity, T_world_device.apply(np.vstack([np.zeros(3), reach_mm * rays])))

    def open_on(self, scene: Opened, name: str, points: NDArray[np.floating[Any]]) -> None:
        """Make scenes open on these points, and on others of the same scene."""
        # points (N, 3) mm
        if not len(points):
            return
        self._there[scene][name] = np.percentile(points, (0.5, 99.5), axis=0)
        ends = np.concatenate(list(self._there[scene].values()))
        middle = (ends.min(axis=0) + ends.max(axis=0)) / 2
        # rerun looks from 1.5 half diagonals away at an angle of 55 degrees, which would cut off a third.
        half = 1.45 * float(np.linalg.norm(ends - middle, axis=1).max()) / math.sqrt(3.0)
        corners = middle + half * np.array([[-1.0], [1.0]])
        self.cloud(REACH[scene], corners, np.full((2, 3), BACKGROUND, np.uint8))

    def directions(self, entity: str) -> None:
        self.log(entity, self._rr.ViewCoordinates.RDF, static=True)


class CommandView:
    """What one command shows; its methods draw on the canvas."""

    def __init__(self, canvas: Canvas) -> None:
        self.canvas = canvas
        self.arrange_views()

    def arrange_views(self) -> None:
        raise NotImplementedError


def shown_step(columns: int) -> int:
    return max(1, -(-columns // SHOWN_COLUMNS))


def subsample_columns(values: NDArray[Scalar]) -> NDArray[Scalar]:
    """Take every n-th pixel, so that at most `SHOWN_COLUMNS` columns remain."""
    # values (h, w)
    step = shown_step(values.shape[1])
    return values[::step, ::step]


def eight_bits(image: Image, bits: int) -> NDArray[np.uint8]:
    return (image >> (bits - 8)).astype(np.uint8)
