"""The viewer: a measurement as it grows, or a recorded one, in rerun.

Left the bench in the camera's frame (x right, y down, z forward): both devices where the
characterisation found them, and the cloud. Right the pictures: camera, pattern, phase,
modulation, coordinates. The timeline `frame` runs over the images of the plan.

A viewer is a convenience: when it fails it says so once, in the log, and the measurement
goes on. rerun draws pinholes without distortion, so an image's edge may lie beside the cloud.
"""

from __future__ import annotations

import atexit
import importlib.util
import logging
import os
import socket
import subprocess
import sys
import tempfile
import time
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
from fpplab.sessions.session import Session

Destination = Literal["window", "browser"] | Path
"""A window on this display, a page for a browser on this computer, or a .rrd file."""

LOCAL = "127.0.0.1"
PATIENCE_S = 20.0
"""How long a viewer may take to start."""
MEMORY = "1GB"
MAP_COLUMNS = 1600
"""Columns beyond which a map is thinned: it is for looking at."""
FAINT = 2.0
"""Modulation in the frames' grey levels under which a wrapped phase is noise, and drawn grey."""
UNMEASURED = (185, 188, 192)
BACKGROUND = (38, 41, 46)

log = logging.getLogger("fpplab")


ViewerMethod = TypeVar("ViewerMethod", bound=Callable[..., None])
Scalar = TypeVar("Scalar", bound=np.generic)


def _harmless(method: ViewerMethod) -> ViewerMethod:
    """A fault of the viewer is logged in one line and switches it off."""

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

    where: the address, file or window that shows it. fault: why it shows nothing any more, or None.
    """

    def __init__(self) -> None:
        self.where = ""
        self.fault: str | None = None
        self._stream: Any = None
        self._server: Server | None = None
        self._plan: tuple[Plan, tuple[int, int], Lattice] | None = None
        self._set: dict[int, NDArray[np.generic]] = {}

    @classmethod
    def open(cls, to: Destination | None = None) -> Self:
        """A viewer in a window, a browser or a file; by default a window where there is a display.

        Never raises for a viewer that does not start: see `fault`.
        """
        viewer = cls()
        viewer._start(to or ("window" if has_display() else "browser"))
        return viewer

    @_harmless
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
            self._server = Server(to)
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
        """Finish the file, or end the viewer; any number of times."""
        stream, self._stream = self._stream, None
        try:
            if stream is not None and (self._server is None or self._server.runs):
                stream.flush(blocking=True)
            if stream is not None:
                stream.disconnect()
        except Exception as error:  # noqa: BLE001 - whatever it is, the measurement goes on
            log.warning("the viewer did not end in order: %s", error)
        finally:
            if self._server is not None:
                self._server.stop()

    def wait(self, announce: Callable[[str], None]) -> None:
        """Tell `announce` where it shows; return once that is closed, or on Ctrl-C; at once for a file."""
        if self._server is None or self.fault is not None:
            return
        with suppress(KeyboardInterrupt):  # Ctrl-C may come as soon as the first word is out
            announce(self.where)
            self._server.wait()

    @_harmless
    def plan(self, plan: Plan, size: tuple[int, int], lattice: Lattice) -> None:
        """Tell what a projector of `size` will show: frames then come with their pattern and phase."""
        self._plan = (plan, size, lattice)
        self._stream.send_blueprint(_blueprint(plan.axes))

    @_harmless
    def frame(self, frame: Frame, pattern: NDArray[np.uint8] | None = None) -> None:
        """A camera frame, and the pattern that it shows (the plan's, by default)."""
        self._stream.set_time("frame", sequence=frame.index)
        self._log("world/camera/image", _picture(_eight_bits(frame.image, frame.settings.bits)))
        if self._plan is not None:
            plan, size, lattice = self._plan
            index, step, _ = list(plan.steps())[frame.index]
            if pattern is None:
                pattern = pattern_image(plan, index, step, size, lattice)
            self._collect(frame, index, step)
        if pattern is not None:
            self._log("world/projector/pattern", _picture(pattern))

    def _collect(self, frame: Frame, index: int, step: int) -> None:
        """Show the wrapped phase of a fringe set once its last frame is in."""
        assert self._plan is not None
        fringe = self._plan[0].fringes[index]
        if step == 0:
            self._set = {}
        self._set[step] = _thinned(frame.image)
        if len(self._set) == fringe.images:
            frames = [self._set[n] for n in range(fringe.images)]
            self.phase(wrapped_phase(frames, fringe), frame.settings.bits)

    @_harmless
    def phase(self, wrapped: Wrapped, bits: int = 8) -> None:
        """The wrapped phase of the latest fringe set, of frames of `bits` depth."""
        faint = FAINT * raw_per_grey(bits)
        phase = np.where(wrapped.modulation >= faint, wrapped.phase, np.float32(np.nan))
        self._map("maps/phase", phase, "twilight", (0.0, TWO_PI))

    @_harmless
    def decoded(self, decoded: Decoded) -> None:
        """Projector coordinates and modulation."""
        for name, colours in (("u", "viridis"), ("v", "viridis"), ("modulation", "inferno")):
            values = getattr(decoded, name)
            known = values[np.isfinite(values)]
            if len(known):
                low, high = np.percentile(known, (0.5, 99.5))
                self._map(f"maps/{name}", values, colours, (float(low), float(high)), static=True)

    @_harmless
    def calibration(self, calibration: Calibration) -> None:
        """Camera and projector in place."""
        reach = 0.5 * calibration.baseline_mm
        self._device("world/camera", calibration.camera, RigidTransform.identity(), reach)
        self._device(
            "world/projector", calibration.projector, calibration.T_projector_camera.inverse(), reach
        )

    @_harmless
    def cloud(self, cloud: Cloud, errors_mm: NDArray[np.floating[Any]] | None = None) -> None:
        """The points, in the camera's grey; or coloured by signed error (N,) where that is given."""
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

    @_harmless
    def epoch(self, epoch: MatchingEpoch) -> None:
        """One epoch of a matching: both devices where the twin has them now, and curves of loss and parts."""
        import rerun as rr

        self.calibration(epoch.parameters.parameters().calibration)
        self._stream.set_time("epoch", sequence=epoch.epoch)
        for name in ("loss", "loss_board", "ssim", "ssim_board", "epsilon_d_px"):
            self._log(f"match/{name}", rr.Scalars(epoch.loss[name]))
        self._log("match/difference", rr.Scalars(epoch.difference))

    @_harmless
    def search(self, round_: SearchEpoch) -> None:
        """One epoch of a search: what was measured in it, and curves of the best until then."""
        import rerun as rr

        self._stream.set_time("epoch", sequence=round_.number)
        best = round_.best.figures
        for name in ("surface_smcd_um", "images", "completeness", "wrong_orders"):
            self._log(f"search/{name}", rr.Scalars(float(getattr(best, name))))
        known = [trial.figures for trial in round_.trials if trial.measured]
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

        self._log(entity, rr.Image(_coloured(_thinned(values), colours, limits)), static=static)

    def _log(self, entity: str, what: Any, static: bool = False) -> None:
        if self._server is not None and not self._server.runs:
            raise DeviceError("viewer", "show", "it was closed")
        self._stream.log(entity, what, static=static)


def view_session(
    session: Session,
    calibration: Calibration | None = None,
    to: Destination | None = None,
    announce: Callable[[str], None] = lambda where: print(where, file=sys.stderr),
) -> str:
    """Show a recorded session with the results that are in it; returns where it was shown.

    A file is complete on return. A window or page is told to `announce`, and stays until it is
    closed, or Ctrl-C. Raises `DataError` for a damaged session, `DeviceError` when the viewer fails.
    """
    from fpplab.pipeline import CLOUD, DECODED

    with Viewer.open(to) as viewer:
        with suppress(DataError):  # a session may not know its projector; it has pictures all the same
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
    """Whether a window can be shown here."""
    if sys.platform.startswith("linux"):
        return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return True


class Server:
    """rerun's own program in a process of its own, reachable from this computer alone.

    `window` shows a window; `browser` serves a page. data: where a recording is sent.
    page: what the operator opens. Raises `DeviceError` when it does not start.
    """

    def __init__(self, kind: Literal["window", "browser"]) -> None:
        data, web = _free_ports(2)
        self.data = f"rerun+http://{LOCAL}:{data}/proxy"
        self._home = tempfile.TemporaryDirectory(prefix="fpplab-viewer-", ignore_cleanup_errors=True)
        command = [_program(), "--bind", LOCAL, "--port", str(data), "--hide-welcome-screen"]
        if kind == "browser":
            self.page = f"http://{LOCAL}:{web}/?url=rerun%2Bhttp://{LOCAL}:{data}/proxy&hide_welcome_screen=1"
            command += ["--serve-web", "--web-viewer-port", str(web), "--server-memory-limit", MEMORY]
        else:
            self.page = "window"
            command += ["--expect-data-soon"]
        environment = self._private()
        self._log = Path(self._home.name) / "log"
        with self._log.open("wb") as stream:
            self._process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=stream, stderr=stream, env=environment
            )
        atexit.register(self.stop)
        try:
            for port in (data, web) if kind == "browser" else (data,):
                self._await(port)
        except BaseException:
            self.stop()
            raise

    def _private(self) -> dict[str, str]:
        """An environment in which the program keeps to itself: it would report its use to its makers."""
        environment = {**os.environ, "XDG_CONFIG_HOME": self._home.name, "RUST_LOG": "warn"}
        subprocess.run(
            [_program(), "analytics", "disable"],
            env=environment,
            timeout=PATIENCE_S,
            check=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        return environment

    @property
    def pid(self) -> int:
        """The process that serves."""
        return self._process.pid

    @property
    def runs(self) -> bool:
        """Whether it is still there: an operator may have closed the window."""
        return self._process.poll() is None

    def wait(self) -> None:
        """Return when it has ended."""
        self._process.wait()

    def stop(self) -> None:
        """End it; any number of times."""
        atexit.unregister(self.stop)
        if self.runs:
            self._process.terminate()
            try:
                self._process.wait(5.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        self._home.cleanup()

    def _await(self, port: int) -> None:
        deadline = time.monotonic() + PATIENCE_S
        while time.monotonic() < deadline:
            if not self.runs:
                words = self._log.read_text(errors="replace").strip().splitlines()
                raise DeviceError(
                    "viewer", "open", f"rerun ended: {words[-1] if words else 'no reason given'}"
                )
            with suppress(OSError), socket.create_connection((LOCAL, port), 1.0):
                return
            time.sleep(0.05)
        raise DeviceError("viewer", "open", f"rerun did not start within {PATIENCE_S:g} s")


def _program() -> str:
    """The program itself, not the script around it, which would leave it behind when ended."""
    found = importlib.util.find_spec("rerun_cli")
    if found is None or found.origin is None:
        raise DeviceError("viewer", "open", "rerun-sdk is not installed", "install fpplab again")
    return str(Path(found.origin).parent / ("rerun.exe" if sys.platform == "win32" else "rerun"))


def _free_ports(n: int) -> list[int]:
    sockets = [socket.create_server((LOCAL, 0)) for _ in range(n)]
    ports = [int(s.getsockname()[1]) for s in sockets]
    for s in sockets:
        s.close()
    return ports


def _blueprint(axes: tuple[Axis, ...] = ("x", "y")) -> Any:
    """The bench left, the pictures right; coordinates of the coded axes alone."""
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
    bench = rrb.Spatial3DView(
        origin="/world",
        name="Bench",
        background=BACKGROUND,
        line_grid=rrb.archetypes.LineGrid3D(visible=False),
    )
    return rrb.Blueprint(
        rrb.Horizontal(bench, rrb.Grid(*views, grid_columns=2), column_shares=[5, 4]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed"),
    )


def _picture(image: NDArray[np.uint8]) -> Any:
    """Compressed as JPEG: it is for looking at, and a tenth of the size."""
    import rerun as rr

    return rr.Image(np.ascontiguousarray(image)).compress(jpeg_quality=90)


def _thinned(values: NDArray[Scalar]) -> NDArray[Scalar]:
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
