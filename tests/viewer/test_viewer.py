"""The data sent to the viewer, read back from a recording; and the viewer's server."""

import logging
import os
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import pytest
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud, save_cloud
from fpplab.core.conventions import Lattice
from fpplab.core.errors import DeviceError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.core.session_names import CLOUD, DECODED
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded
from fpplab.sessions.session import Session
from fpplab.viewer import host
from fpplab.viewer import server as servers
from fpplab.viewer.canvas import Canvas
from fpplab.viewer.colours import BAR_SIZE, UNMEASURED
from fpplab.viewer.measurement import MeasurementView, ShownFrame
from fpplab.viewer.messages import Message, Outbox
from fpplab.viewer.recorded import view_recording, view_session
from fpplab.viewer.server import ViewerServer, has_display
from fpplab.viewer.viewer import Viewer
from sim.matching.record import MatchingEpoch, ParametersFile
from sim.matching.view import MatchingView
from tests.support.plane_twin import CAMERA, nominal, tilted
from tests.support.recordings import Recording

SIZE, MIRRORS = (64, 48), (90, 70)
PLAN = Plan(fringes=(Sinusoid(axis="x", stripes=1.0, steps=3), Sinusoid(axis="x", stripes=6.0, steps=4)))


def patterns() -> Sequence[Pattern]:
    return make_patterns(PLAN, MIRRORS, Lattice.SQUARE)


def frame(index: int, bits: int = 8) -> Frame:
    """The camera sees the middle of the projector's image, pixel by pixel, at half its brightness."""
    pattern = patterns()[index]
    image: Any = pattern.image[: SIZE[1], : SIZE[0]] // 2 + 20
    image = image if bits == 8 else image.astype(np.uint16) << (bits - 8)
    return Frame(image, index, CameraSettings(0.02, 0.0, bits), 0.0, None, pattern.id)


def calibration() -> Calibration:
    camera = Pinhole.from_focal(SIZE, (80.0, 81.0), (31.5, 23.5))
    projector = Pinhole.from_focal(MIRRORS, (120.0, 121.0), (44.5, 69.0))  # looks up: centre at the edge
    pose = RigidTransform.from_vectors(np.array([0.02, -0.3, 0.05]), np.array([-120.0, 7.0, 20.0]))
    return Calibration(camera, projector, pose, {})


def cloud() -> Cloud:
    points = np.random.default_rng(5).normal((0, 0, 400), 20, (200, 3)).astype(np.float32)
    return Cloud(points, colour=np.arange(200, dtype=np.uint8))


def decoded() -> Decoded:
    u = np.tile(np.linspace(0, 89, SIZE[0], dtype=np.float32), (SIZE[1], 1))
    u[:10] = np.nan
    return Decoded(u, np.full_like(u, np.nan), 0 * u + 50, 0 * u + 0.02)


def coloured(recording: Recording, entity: str, row: int | None = None) -> NDArray[np.int64]:
    """A coloured map without its colour bar, at one pixel for each of its own."""
    larger = -(-BAR_SIZE[0] // SIZE[0])
    return recording.rgb(entity, row)[: larger * SIZE[1] : larger, ::larger]


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Recording:
    path = tmp_path_factory.mktemp("live") / "scan.rrd"
    with Canvas(file=path) as canvas:
        view = MeasurementView(canvas)
        view.plan(PLAN, MIRRORS, Lattice.SQUARE)
        for i in range(PLAN.images):
            view.frame(ShownFrame.of(frame(i, bits=12)))
        view.calibration(calibration())
        view.results(decoded(), cloud(), None, None)
    return Recording(path)


def test_every_frame_is_there_with_its_pattern(recording: Recording) -> None:
    assert recording.frames("world/camera/image") == list(range(7))
    assert recording.frames("world/projector/pattern") == list(range(7))
    for i in (0, 5):
        image, pattern = (recording.jpeg(e, i) for e in ("world/camera/image", "world/projector/pattern"))
        assert np.abs(image - frame(i).image).mean() < 3
        assert np.abs(pattern - patterns()[i].image).mean() < 3


def test_the_phase_follows_the_last_frame_of_each_set(recording: Recording) -> None:
    assert recording.frames("maps/phase") == [2, 6]
    # Six stripes over 90 mirrors: the phase, and so its colour, repeats every 15 pixels.
    fine = coloured(recording, "maps/phase", 1)
    assert np.abs(fine[:, 15:60] - fine[:, :45]).mean() < 6
    assert np.abs(fine[:, 7:52] - fine[:, :45]).mean() > 30


def test_devices_are_placed_by_the_calibration(recording: Recording) -> None:
    known = calibration()
    for entity, device, pose in (
        ("world/camera", known.camera, RigidTransform.identity()),
        ("world/projector", known.projector, known.T_projector_camera.inverse()),
    ):
        by_columns = np.array(recording.value(entity, "PinholeProjection")).reshape(3, 3)
        expected = device.matrix.copy()
        expected[:2, 2] += 0.5
        assert pytest.approx(expected, rel=1e-6) == by_columns.T
        assert recording.value(entity, "Resolution") == list(device.size)
        rotation = np.array(recording.value(entity, "TransformMat3x3")).reshape(3, 3).T
        assert rotation == pytest.approx(pose.rotation, abs=1e-6)
        assert recording.value(entity, "Translation3D") == pytest.approx(pose.translation, abs=1e-4)


def test_results_are_logged_as_static(recording: Recording) -> None:
    points = np.array(recording.value("world/cloud", "Position3D"), np.float32)
    assert np.array_equal(points, cloud().points)
    u = coloured(recording, "maps/u")
    assert np.array_equal(u[5, 5], UNMEASURED)
    assert not np.array_equal(u[20, 5], u[20, 60])


def test_the_cloud_is_coloured_by_errors(tmp_path: Path) -> None:
    path = tmp_path / "errors.rrd"
    errors = np.linspace(-0.05, 0.05, 200)
    errors[7] = np.nan
    with Canvas(file=path) as canvas:
        MeasurementView(canvas).results(None, cloud(), None, errors)
    packed = np.array(Recording(path).value("world/coloured/Error", "Color"), np.int64)
    red, blue = packed >> 24, (packed >> 8) & 255
    assert red[0] < 60 < 90 < blue[0]
    assert blue[-1] < 60 < 90 < red[-1]
    assert (red[7], blue[7]) == (UNMEASURED[0], UNMEASURED[2])


def test_epochs_of_a_matching_are_curves(tmp_path: Path) -> None:
    path, parameters = tmp_path / "match.rrd", ParametersFile.of(nominal(tilted(2)))
    losses = [0.4, 0.2, 0.1]
    names = ("loss", "loss_board", "ssim", "ssim_board", "epsilon_d_px")
    with Canvas(file=path) as canvas:
        view = MatchingView(canvas)
        for number, loss in enumerate(losses):
            figures = dict.fromkeys(names, 1.0) | {"loss": loss}
            view.epoch(
                MatchingEpoch(
                    epoch=number,
                    step="light",
                    accepted=True,
                    loss=figures,
                    difference=3.0,
                    seconds=1.0,
                    parameters=parameters,
                )
            )
    found = Recording(path)
    assert found.frames("match/loss", "epoch") == [0, 1, 2]
    assert [found.value("match/loss", "Scalar", n, "epoch") for n in range(3)] == losses
    assert found.value("match/difference", "Scalar", 2, "epoch") == 3.0
    matrix = np.array(found.value("world/camera", "PinholeProjection")).reshape(3, 3).T
    assert matrix[0, 0] == pytest.approx(CAMERA.matrix[0, 0])


def session(path: Path, plan: Plan) -> Session:
    made = Session.create(path, plan)
    for i in range(plan.images):
        made.write(frame(i))
    return made


def test_a_session_is_shown_with_its_results(tmp_path: Path) -> None:
    sized = PLAN.model_copy(
        update={"fringes": tuple(f.model_copy(update={"projector_size": MIRRORS}) for f in PLAN.fringes)}
    )
    made = session(tmp_path / "scan", sized)
    decoded().save(made.path / DECODED)
    save_cloud(cloud(), made.path / CLOUD)
    assert view_session(made, calibration(), tmp_path / "s.rrd") == str(tmp_path / "s.rrd")
    found = Recording(tmp_path / "s.rrd")
    assert found.frames("world/projector/pattern") == list(range(7))
    assert len(found.value("world/cloud", "Position3D")) == 200
    assert coloured(found, "maps/modulation").shape == (48, 64, 3)


def test_a_session_of_an_unknown_projector_has_its_pictures(tmp_path: Path) -> None:
    view_session(session(tmp_path / "scan", PLAN), None, tmp_path / "s.rrd")
    found = Recording(tmp_path / "s.rrd")
    assert found.frames("world/camera/image") == list(range(7))
    assert not {"/world/projector/pattern", "/world/cloud", "/maps/u"} & found.entities()


# The server


@pytest.fixture
def older() -> set[psutil.Process]:
    """What an earlier test of this worker left running, such as the tracker of shared memory."""
    return set(processes())


@pytest.fixture
def started(served: Viewer[MeasurementView], older: set[psutil.Process]) -> list[psutil.Process]:
    """The viewer's processes."""
    return [process for process in processes() if process not in older]


@pytest.fixture
def served(older: set[psutil.Process]) -> Iterator[Viewer[MeasurementView]]:
    with Viewer(MeasurementView, "browser") as viewer:
        show(viewer, 0)
        until(lambda: viewer.where)
        yield viewer


def show(viewer: Viewer[MeasurementView], index: int) -> None:
    viewer.show_one_of_many(MeasurementView.frame, ShownFrame.of(frame(index)))


def until(done: Callable[[], object]) -> None:
    deadline = time.monotonic() + 60
    while not done():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def processes() -> list[psutil.Process]:
    return psutil.Process().children(recursive=True)


def listening(started: list[psutil.Process]) -> list[Any]:
    found = [c for p in started for c in p.net_connections("inet") if c.status == psutil.CONN_LISTEN]
    return [connection.laddr for connection in found]


@pytest.mark.whole
def test_the_viewer_is_reached_from_this_computer_alone_and_ends(
    served: Viewer[MeasurementView], started: list[psutil.Process]
) -> None:
    (address,) = listening(started)  # rerun's own server would give what it has to every site
    assert address.ip == "127.0.0.1"
    assert served.where.startswith(f"http://127.0.0.1:{address.port}/")
    served.close()
    assert len(started) == 2
    assert not any(one.is_running() for one in started)
    served.close()


def asked(address: str, headers: dict[str, str]) -> tuple[int, bytes]:
    """Status, and the first bytes of an answer."""
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=10) as answer:
            return answer.status, answer.read(4)
    except urllib.error.HTTPError as refused:
        with refused:
            return refused.code, b""


@pytest.mark.whole
def test_other_sites_read_nothing(served: Viewer[MeasurementView], started: list[psutil.Process]) -> None:
    recording, host = f"{served.where}recording.rrd", served.where.split("/")[2]
    token = served.where.split("/")[3]
    attacks = [
        (recording, {"Origin": "https://example.com"}),
        (recording, {"Origin": "null"}),
        (recording, {"Origin": f"http://{host}.example.com"}),
        (recording, {"Origin": f"https://{host}"}),
        (recording, {"Host": "example.com"}),  # a name that was pointed at this computer
        (recording, {"Host": f"example.com:{host.split(':')[1]}"}),
        (recording, {"Host": host.replace("127.0.0.1", "localhost")}),
        (f"http://{host}/recording.rrd", {}),
        (f"http://{host}/", {}),
        (f"http://{host}/{token[:-1]}/recording.rrd", {}),
        (f"http://{host}/{token}x/recording.rrd", {}),
        (f"http://{host}/{token.swapcase()}/recording.rrd", {}),
        (f"http://{host}/proxy", {}),
        (f"http://{host}/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages", {}),
    ]
    assert [asked(address, headers) for address, headers in attacks] == [(403, b"")] * len(attacks)
    for outside in ("../../host.py", "%2e%2e/host.py", "re_viewer.js/../log", "open.html"):
        assert asked(served.where + outside, {}) == (404, b""), outside
    assert asked(recording, {}) == (200, b"RRF2")
    assert asked(recording, {"Origin": f"http://{host}"}) == (200, b"RRF2")
    assert len(listening(started)) == 1


@pytest.mark.whole
def test_the_page_may_connect_to_its_server_alone(served: Viewer[MeasurementView]) -> None:
    with urllib.request.urlopen(served.where) as page:
        policy, text = page.headers["Content-Security-Policy"], page.read().decode()
        assert "Access-Control-Allow-Origin" not in page.headers
    assert "default-src 'none'" in policy
    assert re.findall(r"connect-src ([^;]*)", policy) == ["'self'"]
    assert "http" not in text


def test_a_long_recording_keeps_its_beginning_and_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(host, "MAX_BYTES", 60)
    monkeypatch.setattr(host, "FIRST_MESSAGES", 3)
    growing = host.GrowingRecording()
    reading = growing.messages()
    growing.add(b"0" * 10)
    assert next(reading)[:1] == b"0"
    for number in range(1, 10):
        growing.add(str(number).encode() * 10)
    assert [next(reading)[:1] for _ in range(5)] == [b"1", b"2", b"7", b"8", b"9"]


@pytest.mark.whole
@pytest.mark.parametrize("name", ["host.py", "fpplab.viewer.process"])
def test_a_viewer_that_dies_does_not_stop_the_measurement(
    name: str,
    served: Viewer[MeasurementView],
    started: list[psutil.Process],
    caplog: pytest.LogCaptureFixture,
) -> None:
    next(p for p in started if any(name in word for word in p.cmdline())).kill()
    with caplog.at_level(logging.WARNING, "fpplab"):
        for i in (1, 2) * 50:
            show(served, i)
            time.sleep(0.02)
        served.close()
    assert served.fault is not None
    assert [r.getMessage() for r in caplog.records] == [f"the viewer is switched off: {served.fault}"]
    assert "\n" not in served.fault
    _, alive = psutil.wait_procs(started, timeout=10)
    assert not alive


@pytest.mark.whole
def test_a_viewer_that_hangs_is_not_waited_for(
    served: Viewer[MeasurementView], started: list[psutil.Process]
) -> None:
    served.timeouts = replace(served.timeouts, idle_s=1.0)
    for one in started:
        one.suspend()
    since = time.monotonic()
    served.close()
    assert time.monotonic() - since < 0.2 * served.timeouts.finish_s
    for one in started:
        with suppress(psutil.NoSuchProcess):
            one.resume()  # what was suspended could not notice that the process above it has ended
    assert not psutil.wait_procs(started, timeout=30)[1]


@pytest.mark.whole
def test_bad_data_switch_the_viewer_off(
    served: Viewer[MeasurementView], caplog: pytest.LogCaptureFixture
) -> None:
    served.show(MeasurementView.frame, ShownFrame(np.zeros((3, 3)), 0, 8))  # no integers
    served.close()
    assert served.fault is not None
    assert len(caplog.records) == 1


def test_a_full_queue_drops_images_and_never_waits() -> None:
    outbox = Outbox(max_queued=3)
    for k in range(6):
        outbox.add(Message(k, droppable=k != 1))
    outbox.end()
    left = []
    while (message := outbox.take()) is not None:
        left.append(message.content)
    assert left == [1, 4, 5]
    assert outbox.dropped == 3


MEASURING = """
import sys, time
from pathlib import Path
from fpplab.viewer.canvas import CommandView
from fpplab.viewer.viewer import Viewer
from tests.viewer.test_viewer import MeasurementView, calibration
viewer = Viewer(MeasurementView, "browser", Path(sys.argv[1]), lambda where: print(where, flush=True))
viewer.show(MeasurementView.calibration, calibration())
time.sleep(120)
"""


def read_until(address: str, content: bytes) -> None:
    """Read a recording that grows until it holds something."""
    with urllib.request.urlopen(address, timeout=30) as growing:
        known = b""
        while content not in known:
            known += growing.read1(1 << 20)


@pytest.mark.whole
def test_a_measurement_that_is_killed_leaves_no_process_and_its_recording(tmp_path: Path) -> None:
    kept = tmp_path / "view.rrd"
    command = [sys.executable, "-c", MEASURING, str(kept)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        where = program.stdout.readline().strip()
        assert where.startswith("http://127.0.0.1:")
        started = psutil.Process(program.pid).children(recursive=True)
        read_until(f"{where}recording.rrd", b"world/camera")
        program.kill()
    assert len(started) == 2
    _, alive = psutil.wait_procs(started, timeout=20)
    assert not alive
    assert Recording(kept).value("world/camera", "Resolution") == [64, 48]
    seen: list[str] = []

    def close_at_once(where: str) -> None:
        seen.append(where)
        raise KeyboardInterrupt

    view_recording(kept, "browser", close_at_once)
    assert seen[0].startswith("http://127.0.0.1:")


def test_a_viewer_that_does_not_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = tmp_path / "rerun"
    fake.write_text('#!/bin/sh\n[ "$1" = analytics ] && exit 0\necho "no such driver" >&2\nexit 3\n')
    fake.chmod(0o755)
    monkeypatch.setattr(servers, "_find_rerun_program", lambda: str(fake))
    for kind in ("window", "browser"):
        with pytest.raises(DeviceError, match="viewer: open: rerun ended: no such driver"):
            ViewerServer(kind)


@pytest.mark.parametrize(
    ("variables", "display"), [({}, False), ({"DISPLAY": ":0"}, True), ({"WAYLAND_DISPLAY": "w"}, True)]
)
def test_without_a_display_a_browser_is_served(
    variables: dict[str, str], display: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert has_display() is display


WAITING = """
import sys
from pathlib import Path
from fpplab.viewer.recorded import view_session
from fpplab.sessions.session import Session
print(view_session(Session.open(Path(sys.argv[1])), None, "browser", lambda where: print(where, flush=True)))
"""


@pytest.mark.whole
def test_ctrl_c_ends_the_viewer_and_its_processes(tmp_path: Path) -> None:
    made = session(tmp_path / "scan", PLAN)
    command = [sys.executable, "-c", WAITING, str(made.path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ}) as program:
        assert program.stdout is not None
        where = program.stdout.readline()
        children = psutil.Process(program.pid).children(recursive=True)
        program.send_signal(signal.SIGINT)
        rest, _ = program.communicate(timeout=60)
    assert where.startswith("http://127.0.0.1:")
    assert rest == where
    assert program.returncode == 0
    assert children
    assert not any(child.is_running() for child in children)
