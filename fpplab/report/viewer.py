"""The viewer: a measurement as it grows, or a recorded one, shown in rerun.

On the left is the scene in the camera's frame (x right, y down, z forward): both devices where the
characterisation found them, and the cloud. On the right are images and maps: camera, pattern, wrapped phase,
modulation, coordinates. The timeline `frame` runs over the images of the plan.

When the viewer fails, it logs that once and shows nothing more; the measurement goes on. rerun draws pinholes
without distortion, so the edge of an image may lie beside the cloud.
"""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud, load_cloud
from fpplab.core.conventions import TWO_PI, Axis, Floats, Image, Lattice, Map, raw_per_grey
from fpplab.core.errors import DataError, DeviceError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.devices import Frame
from fpplab.matching.record import MatchingEpoch
from fpplab.optimisation.candidate_runner import SearchEpoch
from fpplab.patterns.fringes import pattern_image
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded, Wrapped, wrapped_phase
from fpplab.report.figures import error_limit
from fpplab.report.viewer_server import ViewerServer
from fpplab.sessions.session import Session

Destination = Literal["window", "browser"] | Path
"""A window on this display, a page for a browser on this computer, or a .rrd file."""

MAP_COLUMNS = 1600
"""Columns beyond which a map is subsampled before it is sent."""
MIN_MODULATION = 2.0
"""Modulation in the frames' grey levels below which a wrapped phase is noise, and drawn grey."""
UNMEASURED = (185, 188, 192)
"""RGB of what was not measured."""
BACKGROUND = (38, 41, 46)

log = logging.getLogger("fpplab")


ViewerMethod = TypeVar("ViewerMethod", bound=Callable[..., None])
Scalar = TypeVar("Scalar", bound=np.generic)


def _never_raises(method: ViewerMethod) -> ViewerMethod:
    """Log a fault of the viewer in one line, and switch the viewer off."""

    @wraps(method)
    def guarded(self: Viewer, *args: Any, **kwargs: Any) -> None:
        if self.fault is None:
            try:
                method(self, *args, **kwargs)
            except Exception as error:  # noqa: BLE001 - whatever it is, the measurement goes on
                self.fault = " ".join(str(error).split()) or type(error).__name__
                log.warning("the viewer is switched off: %s", self.fault)

    return cast(ViewerMethod, guarded)


class Viewer:
    """Shows a measurement; made by `open`, used in a `with` block.

    All methods that show something return at once when the viewer has failed, and never raise.

    Attributes
    ----------
    where : str
        The address, file or window that shows it.
    fault : str or None
        Why nothing is shown any more, or None.
    """

    def __init__(self) -> None:
        self.where = ""
        self.fault: str | None = None
        self._stream: Any = None
        self._server: ViewerServer | None = None
        self._plan: tuple[Plan, tuple[int, int], Lattice] | None = None
        self._set: dict[int, NDArray[np.generic]] = {}

    @classmethod
    def open(cls, to: Destination | None = None) -> Self:
        """Open a viewer; where that fails, `fault` says why.

        Parameters
        ----------
        to : Destination, optional
            A window, a page for a browser, or a file; by default a window where there is a display.

        Returns
        -------
        Viewer
            Ready, or with a fault.
        """
        viewer = cls()
        viewer._start(to or ("window" if has_display() else "browser"))
        return viewer

    @_never_raises
    def _start(self, to: Destination) -> None:
        os.environ.setdefault("RUST_LOG", "off")  # what rerun would print says no more than `fault`
        import rerun as rr

        rr.set_strict_mode(True)
        self._stream = rr.RecordingStream("fpplab")
        if isinstance(to, Path):
            to.parent.mkdir(parents=True, exist_ok=True)
            self._stream.save(to, default_blueprint=_blueprint())
            self.where = str(to)
        else:
            self._server = ViewerServer(to)
            self._stream.connect_grpc(self._server.data, default_blueprint=_blueprint())
            self.where = self._server.page
        self._log("world", rr.ViewCoordinates.RDF, static=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Finish the file, or end the server; may be called any number of times."""
        stream, self._stream = self._stream, None
        try:
            if stream is not None and (self._server is None or self._server.runs):
                stream.flush(blocking=True)
            if stream is not None:
                stream.disconnect()
        except Exception as error:  # noqa: BLE001 - whatever it is, the measurement goes on
            log.warning("the viewer did not end properly: %s", error)
        finally:
            if self._server is not None:
                self._server.stop()

    @property
    def closed(self) -> bool:
        """Whether the operator has closed the window, or the server has ended otherwise."""
        return self._server is not None and not self._server.runs

    @_never_raises
    def draw(self, drawing: Callable[[Any], None]) -> None:
        """Let a function log what it likes.

        Parameters
        ----------
        drawing : callable
            Given rerun's recording stream.

        Raises
        ------
        DeviceError
            Never: that the viewer was closed becomes its `fault`.
        """
        if self.closed:
            raise DeviceError("viewer", "show", "it was closed")
        drawing(self._stream)

    def wait(self, announce: Callable[[str], None]) -> None:
        """Wait until the window or page is closed or Ctrl-C is pressed; return at once for a file.

        Parameters
        ----------
        announce : callable
            Told the address or window before the wait.
        """
        if self._server is None or self.fault is not None:
            return
        with suppress(KeyboardInterrupt):  # Ctrl-C may come as soon as the first word is out
            announce(self.where)
            self._server.wait()

    @_never_raises
    def plan(self, plan: Plan, size: tuple[int, int], lattice: Lattice) -> None:
        """Announce what the projector will show, so that frames are shown with their pattern and phase.

        Parameters
        ----------
        plan : Plan
            Of the measurement.
        size : tuple of int
            Width and height of the projector in mirrors.
        lattice : Lattice
            Of the projector's mirrors.
        """
        self._plan = (plan, size, lattice)
        self._stream.send_blueprint(_blueprint(plan.axes))

    @_never_raises
    def frame(self, frame: Frame, pattern: NDArray[np.uint8] | None = None) -> None:
        """Show a camera frame, and the pattern that it shows.

        Parameters
        ----------
        frame : Frame
            Its index is that of the image in the plan.
        pattern : NDArray of uint8, optional
            Image of the projector; that of the plan by default.
        """
        self._stream.set_time("frame", sequence=frame.index)
        self._log("world/camera/image", _jpeg(_eight_bits(frame.image, frame.settings.bits)))
        if self._plan is not None:
            plan, size, lattice = self._plan
            index, step, _ = list(plan.steps())[frame.index]
            if pattern is None:
                pattern = pattern_image(plan, index, step, size, lattice)
            self._collect(frame, index, step)
        if pattern is not None:
            self._log("world/projector/pattern", _jpeg(pattern))

    def _collect(self, frame: Frame, index: int, step: int) -> None:
        """Show the wrapped phase of a fringe set once its last frame is in."""
        assert self._plan is not None
        fringe = self._plan[0].fringes[index]
        if step == 0:
            self._set = {}
        self._set[step] = _subsampled(frame.image)
        if len(self._set) == fringe.images:
            frames = [self._set[n] for n in range(fringe.images)]
            self.phase(wrapped_phase(frames, fringe), frame.settings.bits)

    @_never_raises
    def phase(self, wrapped: Wrapped, bits: int = 8) -> None:
        """Show the wrapped phase of the latest fringe set.

        Parameters
        ----------
        wrapped : Wrapped
            Phase in rad and modulation in raw levels.
        bits : int
            Bit depth of the frames.
        """
        faint = MIN_MODULATION * raw_per_grey(bits)
        phase = np.where(wrapped.modulation >= faint, wrapped.phase, np.float32(np.nan))
        self._map("maps/phase", phase, "twilight", (0.0, TWO_PI))

    @_never_raises
    def decoded(self, decoded: Decoded) -> None:
        """Show projector coordinates and modulation.

        Parameters
        ----------
        decoded : Decoded
            Maps (h, w), NaN where not measured.
        """
        for name, colours in (("u", "viridis"), ("v", "viridis"), ("modulation", "inferno")):
            values = getattr(decoded, name)
            known = values[np.isfinite(values)]
            if len(known):
                low, high = np.percentile(known, (0.5, 99.5))
                self._map(f"maps/{name}", values, colours, (float(low), float(high)), static=True)

    @_never_raises
    def calibration(self, calibration: Calibration) -> None:
        """Show camera and projector at their poses.

        Parameters
        ----------
        calibration : Calibration
            In the camera's frame.
        """
        reach = 0.5 * calibration.baseline_mm
        self._device("world/camera", calibration.camera, RigidTransform.identity(), reach)
        self._device(
            "world/projector", calibration.projector, calibration.T_projector_camera.inverse(), reach
        )

    @_never_raises
    def cloud(self, cloud: Cloud, errors_mm: NDArray[np.floating[Any]] | None = None) -> None:
        """Show the points, in the camera's grey levels or coloured by error.

        Parameters
        ----------
        cloud : Cloud
            N points in mm in the camera's frame.
        errors_mm : NDArray of float, optional
            Signed errors (N,), NaN where not known.
        """
        import rerun as rr

        if errors_mm is not None:
            errors = np.asarray(errors_mm, np.float32)
            limit = error_limit(errors)
            colours = _coloured(errors, "RdBu_r", (-limit, limit))
        elif cloud.colour is not None:
            bright = max(float(np.percentile(cloud.colour, 98)), 1.0)
            colours = _coloured(cloud.colour.astype(np.float32), "gray", (0.0, bright))
        else:
            low, high = np.percentile(cloud.points[:, 2], (1, 99))
            colours = _coloured(cloud.points[:, 2], "viridis_r", (float(low), float(high)))
        points = rr.Points3D(cloud.points, colors=colours, radii=rr.Radius.ui_points(1.2))
        self._log("world/cloud", points, static=True)

    @_never_raises
    def epoch(self, epoch: MatchingEpoch) -> None:
        """Show an epoch of a matching: the twin's devices, and curves of the loss with its parts.

        Parameters
        ----------
        epoch : MatchingEpoch
            The latest.
        """
        import rerun as rr

        self.calibration(epoch.parameters.parameters().calibration)
        self._stream.set_time("epoch", sequence=epoch.epoch)
        for name in ("loss", "loss_board", "ssim", "ssim_board", "epsilon_d_px"):
            self._log(f"match/{name}", rr.Scalars(epoch.loss[name]))
        self._log("match/difference", rr.Scalars(epoch.difference))

    @_never_raises
    def search(self, epoch: SearchEpoch) -> None:
        """Show an epoch of a search: the candidates measured in it, and curves of the best so far.

        Parameters
        ----------
        epoch : SearchEpoch
            The latest.
        """
        import rerun as rr

        self._stream.set_time("epoch", sequence=epoch.number)
        best = epoch.best.figures
        for name in ("surface_smcd_um", "images", "completeness", "wrong_orders"):
            self._log(f"search/{name}", rr.Scalars(float(getattr(best, name))))
        known = [trial.figures for trial in epoch.trials if trial.measured]
        points = [(figures.images, -figures.surface_smcd_um) for figures in known]
        self._log("search/candidates", rr.Points2D(points, radii=rr.Radius.ui_points(3.0)))

    def _device(self, entity: str, device: Pinhole, T_world_device: RigidTransform, reach: float) -> None:
        import rerun as rr

        matrix = device.matrix.copy()
        matrix[:2, 2] += 0.5  # rerun counts from the corner of the first pixel, not from its centre
        pose = rr.Transform3D(translation=T_world_device.translation, mat3x3=T_world_device.rotation)
        model = rr.Pinhole(
            image_from_camera=matrix,
            resolution=device.size,
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=reach,
        )
        self._log(entity, pose, static=True)
        self._log(entity, model, static=True)

    def _map(
        self, entity: str, values: Map, colours: str, limits: tuple[float, float], static: bool = False
    ) -> None:
        import rerun as rr

        self._log(entity, rr.Image(_coloured(_subsampled(values), colours, limits)), static=static)

    def _log(self, entity: str, what: Any, static: bool = False) -> None:
        if self.closed:
            raise DeviceError("viewer", "show", "it was closed")
        self._stream.log(entity, what, static=static)


def view_session(
    session: Session,
    calibration: Calibration | None = None,
    to: Destination | None = None,
    announce: Callable[[str], None] = lambda where: print(where, file=sys.stderr),
) -> str:
    """Show a recorded session with the results that are saved in it.

    A file is complete on return. A window or page is announced, and stays until it is closed or Ctrl-C is
    pressed.

    Parameters
    ----------
    session : Session
        Frames are read without verification of their checksums.
    calibration : Calibration, optional
        Of the rig; without it the devices are not shown.
    to : Destination, optional
        As `Viewer.open`.
    announce : callable
        Told the address or window; printed to stderr by default.

    Returns
    -------
    str
        The address, file or window that showed it.

    Raises
    ------
    DataError
        The session is damaged.
    DeviceError
        The viewer fails.
    """
    from fpplab.pipeline import CLOUD, DECODED

    with Viewer.open(to) as viewer:
        with suppress(DataError):  # a session may not know its projector; its images are shown all the same
            viewer.plan(session.plan, *session.projector())
        if calibration is not None:
            viewer.calibration(calibration)
        for record in session.records:
            image = session.read(record.index, verify=False)
            viewer.frame(Frame(image, record.index, record.settings, record.host_time_s))
        if (session.path / DECODED).is_file():
            viewer.decoded(Decoded.load(session.path / DECODED))
        if (session.path / CLOUD).is_file():
            viewer.cloud(load_cloud(session.path / CLOUD))
        if viewer.fault is not None:
            raise DeviceError("viewer", "show", viewer.fault, "save to a file instead")
        viewer.wait(announce)
        return viewer.where


def has_display() -> bool:
    """Tell whether a window can be shown here.

    Returns
    -------
    bool
        On Linux, whether DISPLAY or WAYLAND_DISPLAY is set; True elsewhere.
    """
    if sys.platform.startswith("linux"):
        return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return True


def _blueprint(axes: tuple[Axis, ...] = ("x", "y")) -> Any:
    """Lay out the scene on the left, images on the right; coordinates of the coded axes only."""
    import rerun.blueprint as rrb

    coordinates = {"x": ("Projector columns u", "/maps/u"), "y": ("Projector rows v", "/maps/v")}
    pictures = [
        ("Camera", "/world/camera/image"),
        ("Pattern", "/world/projector/pattern"),
        ("Wrapped phase", "/maps/phase"),
        ("Modulation", "/maps/modulation"),
        *(coordinates[axis] for axis in axes),
    ]
    views = [rrb.Spatial2DView(origin=origin, name=name, background=BACKGROUND) for name, origin in pictures]
    scene = rrb.Spatial3DView(
        origin="/world",
        name="Scene",
        background=BACKGROUND,
        line_grid=rrb.archetypes.LineGrid3D(visible=False),
    )
    return rrb.Blueprint(
        rrb.Horizontal(scene, rrb.Grid(*views, grid_columns=2), column_shares=[5, 4]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed"),
    )


def _jpeg(image: NDArray[np.uint8]) -> Any:
    """Compress an image as JPEG, a tenth of the size, since it is only for display."""
    import rerun as rr

    return rr.Image(np.ascontiguousarray(image)).compress(jpeg_quality=90)


def _subsampled(values: NDArray[Scalar]) -> NDArray[Scalar]:
    """Every n-th pixel of a map, so that at most `MAP_COLUMNS` columns remain."""
    step = max(1, -(-values.shape[1] // MAP_COLUMNS))
    return values[::step, ::step]


def _eight_bits(image: Image, bits: int) -> NDArray[np.uint8]:
    return (image >> (bits - 8)).astype(np.uint8)


def _coloured(
    values: NDArray[np.floating[Any]], colours: str, limits: tuple[float, float]
) -> NDArray[np.uint8]:
    """RGB of values, grey where they are not finite."""
    import matplotlib as mpl

    low, high = limits
    level: Floats = np.clip((values - low) / max(high - low, 1e-12), 0.0, 1.0)
    table = (mpl.colormaps[colours](np.linspace(0, 1, 256))[:, :3] * 255).astype(np.uint8)
    known = np.isfinite(level)
    rgb: NDArray[np.uint8] = table[np.rint(np.where(known, level, 0.0) * 255).astype(np.intp)]
    rgb[~known] = UNMEASURED
    return rgb
