"""Recorded sessions, and recordings that a view left, in the viewer."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud, load_cloud
from fpplab.core.depth import DepthRange
from fpplab.core.errors import DataError, DeviceError
from fpplab.core.progress import Progress, no_progress
from fpplab.core.session_names import CLOUD, DECODED
from fpplab.devices import Frame
from fpplab.phase import Decoded
from fpplab.sessions.session import Session
from fpplab.viewer.canvas import Canvas
from fpplab.viewer.measurement import MeasurementView, ShownFrame
from fpplab.viewer.server import ViewerPlace, open_server
from fpplab.viewer.viewer import Viewer

CloudErrors = Callable[[Cloud], NDArray[np.floating[Any]]]
"""Gives the signed distances (N,) of a cloud from the true shape in µm, NaN where not known."""


def view_session(
    session: Session,
    calibration: Calibration | None = None,
    to: ViewerPlace | Path = "anywhere",
    announce: Callable[[str], object] = print,
    errors: CloudErrors | None = None,
    progress: Progress = no_progress,
) -> str:
    """Show a recorded session with the results that are saved in it; a window or page stays until closed."""
    if isinstance(to, Path):
        to.parent.mkdir(parents=True, exist_ok=True)
        with Canvas(file=to) as canvas:
            view = MeasurementView(canvas)
            _show_recorded(session, calibration, errors, lambda method, *args: method(view, *args), progress)
        return str(to)
    with Viewer(MeasurementView, to, complete=True) as viewer:
        _show_recorded(session, calibration, errors, viewer.show, progress)
        viewer.wait(announce)
        if viewer.fault is not None:
            raise DeviceError("viewer", "show", viewer.fault, "save to a file instead")
        return viewer.where


def view_recording(
    path: Path, shown: ViewerPlace = "anywhere", announce: Callable[[str], object] = print
) -> str:
    with path.open("rb") as stream:
        if stream.read(4) != b"RRF2":
            raise DataError(f"{path}: is no recording of the viewer, or is damaged; view its session instead")
    server = open_server(shown, path)
    try:
        with suppress(KeyboardInterrupt):
            announce(server.page)
            server.wait()
        return server.page
    finally:
        server.stop()


def _show_recorded(
    session: Session,
    calibration: Calibration | None,
    errors: CloudErrors | None,
    show: Callable[..., None],
    progress: Progress,
) -> None:
    depth: DepthRange | None = None
    with suppress(DataError):  # a session may not know its projector; its images are shown all the same
        show(MeasurementView.plan, session.plan, *session.projector())
        depth = session.depth
    if calibration is not None:
        show(MeasurementView.calibration, calibration)
    for number, record in enumerate(session.records, 1):
        image = session.read(record.index, verify=False)
        frame = Frame(image, record.index, record.settings, record.host_time_s)
        show(MeasurementView.frame, ShownFrame.of(frame))
        progress(number / len(session.records))
    decoded = Decoded.load(session.path / DECODED) if (session.path / DECODED).is_file() else None
    if (session.path / CLOUD).is_file():
        cloud = load_cloud(session.path / CLOUD)
        show(MeasurementView.results, decoded, cloud, depth, errors(cloud) if errors else None)
    elif decoded is not None:
        show(MeasurementView.maps, decoded)
