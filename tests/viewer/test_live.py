"""What the set-up sends to the viewer, read back from a recording."""

import math
from pathlib import Path

import numpy as np
import pytest

from fpplab.setup.live.expectation import RigGeometry, WorkingPoint
from fpplab.setup.live.orders import Order
from fpplab.viewer.canvas import SHOWN_COLUMNS
from fpplab.viewer.live import DARK, SATURATED, LitImage, LiveFrames, LiveView
from fpplab.viewer.viewer import Viewer
from tests.setup.live.benches import PLAN, Operator, operate, rig_file
from tests.setup.live.test_expectation import converging
from tests.support.recordings import Recording


def test_saturated_and_dark_pixels_are_painted_in() -> None:
    image = np.full((40, 3 * SHOWN_COLUMNS), 100, np.uint16) << 4
    image[20, 7] = 4095  # one pixel, which the reduction to a third would lose
    image[0] = 0
    rgb = LitImage.of(image, 12, image < 50).painted()
    assert rgb.shape == (14, SHOWN_COLUMNS, 3)
    assert tuple(rgb[6, 2]) == SATURATED
    assert tuple(rgb[5, 5]) == (100, 100, 100)
    assert np.abs(rgb[0, 0].astype(int) - np.array(DARK) // 2).max() <= 1
    assert not LitImage.of(image, 12, None).painted()[0].any()


@pytest.mark.whole
def test_the_recording_has_image_focus_histogram_and_scene(tmp_path: Path) -> None:
    path, geometry = tmp_path / "live.rrd", RigGeometry(converging(18.0))
    with Viewer(LiveView, None, recording=path, complete=True) as viewer:
        viewer.show(LiveView.scene, geometry, 400.0)
        shown = LiveFrames(viewer, max_rate_hz=math.inf)

        class Watching(Operator):
            def __call__(self, status, frame, pattern, dark):  # type: ignore[no-untyped-def]
                if frame is not None:
                    shown.show(status, frame, pattern, dark)
                return super().__call__(status, frame, pattern, dark)

        board = {
            "target": "board.yaml",
            "poses": [{"rotation_deg": [0, 0, 0], "translation_mm": [0, 0, 450]}],
        }
        rig = rig_file(tmp_path, items={"board": board}, mounted="board")
        working = WorkingPoint(geometry, PLAN, 400.0)
        operator = Watching(Order.WHITE, Order.QUIT, after=17)
        operate(rig, operator, working=working)
    assert viewer.fault is None
    found = Recording(path)
    frames = len(operator.frames)
    assert found.frames("world/camera/image") == list(range(1, frames + 1))
    assert found.frames("light/histogram") == list(range(1, frames + 1))
    # A pattern is sent when it changes, and what is measured when it is measured.
    assert found.frames("world/projector/pattern")[:9] == list(range(1, 10))
    assert len(found.frames("world/projector/pattern")) < frames
    assert found.frames("focus/projector") == [8, 16]
    assert found.frames("focus/camera")[:2] == [8, 16]
    assert found.value("focus/camera", "Scalar", 0) == 100.0
    assert set(found.value("maps/camera_focus/share", "Text", 0)) == {"–"}  # nothing is measured yet
    labels = found.value("maps/camera_focus/share", "Text", 1)
    assert len(labels) == 24
    assert "100" in labels
    counts = np.array(found.value("light/histogram", "TensorData", 0)["buffer"])
    assert len(counts) > 0
    strips = found.value("world/overlap", "LineStrip3D")
    assert len(strips) == 7
    assert "peak" in found.value("words", "Text", 1)
