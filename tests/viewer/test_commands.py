"""`--view` and `--keep-open` of whole commands, and what is left to be looked at afterwards."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import psutil
import pytest
import yaml

from tests.sim.conftest import RIG, plain, write_world
from tests.support.browser import SOFTWARE_WEBGL, chromium
from tests.support.commands import NO_DISPLAY, ROOT, Command, Demo
from tests.support.recordings import Recording
from tests.viewer.test_viewer import until

pytestmark = pytest.mark.whole


def replayed(demo: Demo, folder: Path) -> Path:
    """A rig that replays a scan of the demonstration."""
    recorded = {"backend": "fpplab.sessions.replay:RecordedSession", "session": str(demo.folder / "pyramid")}
    rig = {
        "name": "replay",
        "bench": recorded,
        "camera": {"backend": "fpplab.sessions.replay:ReplayCamera"},
        "projector": {"backend": "fpplab.sessions.replay:ReplayProjector"},
    }
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig))
    return folder / "rig.yaml"


def test_a_scan_ends_with_its_work_and_leaves_its_recording(
    fpplab: Command, demo: Demo, tmp_path: Path
) -> None:
    out, calibration = tmp_path / "scan", demo.folder / "calibration.yaml"
    rig = replayed(demo, tmp_path)
    done = fpplab(
        "scan", "--rig", rig, "--calibration", calibration, "--out", out, "--view", "--json", env=NO_DISPLAY
    )
    assert done.code == 0, done.err
    assert "Watch it at http://127.0.0.1:" in done.err
    shown = Recording(out / "view.rrd")
    assert len(shown.value("world/cloud", "Position3D")) == done.json["points"]
    coloured = shown.entities()
    names = ("Uncertainty", "Order_risk", "Depth")
    assert {f"/world/coloured/{name}" for name in names} <= coloured
    assert {f"/bars/world/coloured/{name}" for name in names} <= coloured
    again = fpplab(
        "reconstruct", out, "--calibration", calibration, "--out", tmp_path / "c.ply", "--view", "--json",
        env=NO_DISPLAY,
    )  # fmt: skip
    assert again.code == 0, again.err
    rebuilt = Recording(tmp_path / "c.rrd")
    assert len(rebuilt.value("world/cloud", "Position3D")) == again.json["points"]


def test_a_cloud_is_coloured_by_its_error(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    scan = demo.folder / "pyramid"
    done = fpplab(
        "view", scan, "--mesh", scan / "truth.stl", "--align", "--out", tmp_path / "view.rrd", "--json"
    )
    assert done.code == 0, done.err
    compared = fpplab(
        "compare", scan / "cloud.ply", scan / "truth.stl", "--align", "--out", tmp_path / "c.png", "--view",
        "--json", env=NO_DISPLAY,
    )  # fmt: skip
    assert compared.code == 0, compared.err
    for path in (tmp_path / "view.rrd", tmp_path / "c.rrd"):
        packed = np.array(Recording(path).value("world/coloured/Error", "Color"), np.int64)
        assert len(np.unique(packed)) > 50
    refused = fpplab("view", scan, "--align")
    assert refused.code == 2
    assert "--mesh" in refused.err


def test_poses_are_shown_as_boards(fpplab: Command, demo: Demo, tmp_path: Path) -> None:
    done = fpplab(
        "characterise", demo.folder / "board", "--target", "target_paper", "--out", tmp_path / "c.yaml",
        "--view", "--json", env=NO_DISPLAY,
    )  # fmt: skip
    assert done.code == 0, done.err
    shown = Recording(tmp_path / "c.rrd")
    assert len(shown.value("world/boards", "Position3D")) > 100
    assert shown.value("diagrams/projector", "MediaType") == "image/png"


@pytest.fixture
def kept_open(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A command that has ended its work, with its viewer open; and the address."""
    write_world(tmp_path, {**plain(), "mounted": "card"})
    (tmp_path / "rig.yaml").write_text(RIG)
    words = ["--item", "card", "--levels", "6", "--repeats", "1", "--out", "r.yaml", "--keep-open", "--json"]
    command = [sys.executable, "-m", "fpplab", "gamma", "--rig", "rig.yaml", *words]
    environment = {**os.environ, **NO_DISPLAY, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    ) as program:
        assert program.stdout is not None
        assert program.stderr is not None
        line = ""
        for line in program.stderr:
            if "close it, or press Ctrl-C" in line:
                break
        assert len(json.loads(program.stdout.readline())["levels"]) == 6  # the answer is out before
        yield program, line.split(": close it")[0]
        program.kill()


def test_ctrl_c_closes_what_is_kept_open(kept_open: tuple[subprocess.Popen[str], str]) -> None:
    program, _ = kept_open
    started = psutil.Process(program.pid).children(recursive=True)
    assert len(started) == 2
    program.send_signal(signal.SIGINT)
    assert program.wait(30) == 0
    assert not psutil.wait_procs(started, timeout=10)[1]


def test_a_page_that_is_closed_ends_the_command(
    kept_open: tuple[subprocess.Popen[str], str], tmp_path: Path
) -> None:
    program, address = kept_open
    with chromium(tmp_path, *SOFTWARE_WEBGL) as browser:
        browser.open(address)
        browser.until("document.querySelector('#message') === null", 90.0)
        assert program.poll() is None
    assert program.wait(30) == 0


WINDOW = """
import sys
import time
from pathlib import Path
from fpplab.viewer.viewer import Viewer
from fpplab.viewer.response import ResponseView
viewer = Viewer(ResponseView, recording=Path(sys.argv[1]))
viewer.wait_open()
print(viewer.where, flush=True)
sys.stdin.read(1)
end_s = time.monotonic() + 30.0  # a thread notices the end a moment later
while not viewer.window_closed and time.monotonic() < end_s:
    time.sleep(0.05)
print(viewer.window_closed, viewer.fault, flush=True)
viewer.close()
"""

RERUN = """#!{python}
import socket, sys
from urllib.parse import urlsplit
if "analytics" in sys.argv:
    sys.exit()
other = urlsplit(sys.argv[sys.argv.index("--connect") + 1])
assert sys.argv[1] == "-"
served = socket.create_connection((other.hostname, other.port))
assert sys.stdin.buffer.read(4) == b"RRF2"
served.settimeout(0.5)
try:
    print(served.recv(1))
except TimeoutError:
    open({got!r}, "w").close()
sys.stdin.buffer.read()
"""
"""A program that opens a window as rerun does, on computers without a graphics card as well."""


def test_where_there_is_a_display_a_window_is_opened(tmp_path: Path) -> None:
    rerun, got = tmp_path / "rerun_cli" / "rerun", tmp_path / "got"
    rerun.parent.mkdir()
    (rerun.parent / "__init__.py").touch()
    rerun.write_text(RERUN.format(python=sys.executable, got=str(got)), encoding="utf-8")
    rerun.chmod(0o755)
    places = os.pathsep.join([str(tmp_path), *sys.path])
    environment = {**os.environ, "DISPLAY": ":99", "WAYLAND_DISPLAY": "", "PYTHONPATH": places}
    with subprocess.Popen(
        [sys.executable, "-c", WINDOW, str(tmp_path / "view.rrd")],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment,
    ) as program:  # fmt: skip
        assert program.stdin is not None
        assert program.stdout is not None
        assert program.stdout.readline() == "window\n"
        until(got.exists)
        started = psutil.Process(program.pid).children(recursive=True)
        host = next(one for one in started if any("host.py" in word for word in one.cmdline()))
        for one in (host, *host.children()):  # a server would give what it has to any site
            assert not [c for c in one.net_connections("inet") if c.status == psutil.CONN_LISTEN]
        for one in host.children():
            one.kill()  # as closing the window ends it
        psutil.wait_procs([host], timeout=60)
        program.stdin.write("x")
        program.stdin.close()
        assert program.stdout.readline().startswith("True")
        assert program.wait(30) == 0
