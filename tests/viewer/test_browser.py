"""What an operator sees in a browser, and what the browser reaches: pictures and logs of a real one."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from fpplab.clouds import save_cloud
from fpplab.core.files import make_directory
from fpplab.core.session_names import CLOUD, DECODED
from fpplab.optimisation.scope import SearchScope
from fpplab.viewer import host
from fpplab.viewer.canvas import BACKGROUND, Canvas
from fpplab.viewer.measurement import MeasurementView
from fpplab.viewer.recorded import view_session
from fpplab.viewer.search import SearchView
from fpplab.viewer.server import ViewerServer
from sim.matching.record import MatchingEpoch, ParametersFile
from sim.matching.view import CURVES, MatchingView
from tests.optimisation.test_search_whole import ITEMS, searched, study
from tests.support.browser import SOFTWARE_WEBGL, chromium, hosts, number_of_colours
from tests.support.plane_twin import nominal, tilted
from tests.viewer.test_viewer import MIRRORS, PLAN, calibration, cloud, decoded, session

pytestmark = pytest.mark.nightly
WINDOW = (1600, 1000)
SCENE = (slice(80, 962), slice(0, 886))
"""Rows and columns of the scene of a measurement in that window."""
FILLED = {"session": 3500, "match": 4000, "search": 2500}
"""Least number of colours of the page. Layouts without data were measured to have 1,500 to 1,600, filled ones
6,021, 7,234 and 3,784."""


def a_session(path: Path, folder: Path) -> None:
    sized = [f.model_copy(update={"projector_size": MIRRORS}) for f in PLAN.fringes]
    made = session(folder / "scan", PLAN.model_copy(update={"fringes": tuple(sized)}))
    decoded().save(made.path / DECODED)
    save_cloud(cloud(), made.path / CLOUD)
    view_session(made, calibration(), path, errors=lambda shown: shown.points[:, 0])


def a_matching(path: Path, folder: Path) -> None:
    names = [*CURVES, "loss_spread"]
    across = np.linspace(0, 200, 300, dtype=np.float32)
    bench = np.tile(100 + 100 * np.sin(across / 6), (200, 1)).astype(np.float32)
    with Canvas(file=path) as canvas:
        view = MatchingView(canvas)
        for number in range(4):
            figures = dict.fromkeys(names, 0.5 / (1 + number))
            view.epoch(
                MatchingEpoch(
                    epoch=number,
                    step="light",
                    accepted=number != 2,
                    loss=figures,
                    difference=9.0 / (1 + number),
                    seconds=1.0,
                    parameters=ParametersFile.of(nominal(tilted(3))),
                )
            )
            view.images(
                bench, bench + np.outer(np.linspace(0, 9, 200), np.ones(300, np.float32)) / (1 + number)
            )


def a_search(path: Path, folder: Path) -> None:
    with Canvas(file=path) as canvas:
        wanted = study(artefacts=ITEMS, space={"stage_mm": [-40, 40]})
        searched(SearchScope.BASELINE, wanted, folder / "p.yaml", observe=SearchView(canvas).epoch)


def a_rig(path: Path, folder: Path) -> None:
    with Canvas(file=path) as canvas:
        view = MeasurementView(canvas)
        view.calibration(calibration())
        view.cloud(cloud())


def nothing(path: Path, folder: Path) -> None:
    with Canvas(file=path) as canvas:
        MatchingView(canvas)


SHOWN: dict[str, Callable[[Path, Path], None]] = {
    "session": a_session, "match": a_matching, "search": a_search,
}  # fmt: skip


@pytest.mark.parametrize("what", SHOWN)
def test_views_are_filled_and_nothing_but_this_computer_is_reached(what: str, tmp_path: Path) -> None:
    SHOWN[what](tmp_path / "view.rrd", tmp_path)
    server = ViewerServer("browser", tmp_path / "view.rrd")
    try:
        with chromium(tmp_path, *SOFTWARE_WEBGL) as browser:
            browser.open(server.page, *WINDOW)
            seen = browser.settled_picture(tmp_path / f"{what}.png", FILLED[what])
            said = browser.faults()
        assert number_of_colours(seen) >= FILLED[what]
        assert hosts(browser.log) == {"127.0.0.1"}
        # The compiled viewer did try to send usage statistics; the policy kept that from the network.
        assert any("violates the following Content Security Policy" in words for words in said)
    finally:
        server.stop()


def test_both_devices_are_whole_in_the_scene_of_the_rig(tmp_path: Path) -> None:
    a_rig(tmp_path / "view.rrd", tmp_path)
    server = ViewerServer("browser", tmp_path / "view.rrd")
    try:
        with chromium(tmp_path, *SOFTWARE_WEBGL) as browser:
            browser.open(server.page, *WINDOW)
            seen = browser.settled_picture(tmp_path / "rig.png", 500)
        scene = seen[SCENE].astype(np.int64)
        drawn = np.argwhere(np.abs(scene - np.array(BACKGROUND)).max(axis=2) > 40)
        size, (first, last) = np.array(scene.shape[:2]), (drawn.min(axis=0), drawn.max(axis=0))
        assert (first > 3).all()
        assert (last < size - 4).all()
        assert ((last - first) / size).max() > 0.5
    finally:
        server.stop()


def test_the_log_would_show_another_host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same page without its policy sends statistics to the viewer's maker: the log names the host."""
    source = Path(host.__file__)
    copy = tmp_path / "open"
    make_directory(copy, lambda folder: (folder / "web").mkdir())
    for name in host.OWN_FILES.values():
        (copy / "web" / name).write_bytes((source.parent / "web" / name).read_bytes())
    header = '    "Content-Security-Policy": POLICY,\n'
    assert header in source.read_text()
    (copy / "host.py").write_text(source.read_text().replace(header, ""))
    monkeypatch.setattr(host, "__file__", str(copy / "host.py"))
    a_matching(tmp_path / "view.rrd", tmp_path)
    server = ViewerServer("browser", tmp_path / "view.rrd")
    try:
        with chromium(tmp_path, *SOFTWARE_WEBGL) as browser:
            browser.open(server.page, *WINDOW)
            browser.settled_picture(tmp_path / "seen.png", FILLED["match"])
        assert {one for one in hosts(browser.log) if one != "127.0.0.1"} == {"tel.rerun.io"}
    finally:
        server.stop()


def test_an_empty_layout_does_not_pass_for_a_filled_one(tmp_path: Path) -> None:
    nothing(tmp_path / "view.rrd", tmp_path)
    server = ViewerServer("browser", tmp_path / "view.rrd")
    try:
        with chromium(tmp_path, *SOFTWARE_WEBGL) as browser:
            browser.open(server.page, *WINDOW)
            with pytest.raises(AssertionError, match="colours after"):
                browser.settled_picture(tmp_path / "seen.png", min(FILLED.values()), patience_s=12.0)
    finally:
        server.stop()
