"""What is printed of a session, a calibration and a cloud: one line."""

from pathlib import Path

import numpy as np

from fpplab import Cloud
from tests.diagnosis.scenes import Bench
from tests.support.recorded import record


def test_each_is_one_line(tmp_path: Path) -> None:
    points = np.array([[0, 0, 450], [10, 20, 460]], np.float32)
    cloud = Cloud(points, colour=np.array([1, 2], np.uint8))
    assert repr(cloud) == "<Cloud: 2 points, 10.0 x 20.0 x 10.0 mm; colour>"
    assert repr(Cloud(points)) == "<Cloud: 2 points, 10.0 x 20.0 x 10.0 mm>"
    assert repr(record(tmp_path / "s", 3)) == f"<Session {tmp_path / 's'}: 3 of 4 frames>"
    shown = repr(Bench().rig())
    assert shown.startswith(
        "<Calibration: camera 480 x 320 (f 1278.1 px), projector 912 x 1140 (f 2150.0 px), "
    )
    assert shown.endswith("square lattice, baseline 150.55 mm>")
