"""A scan is fitted to the part that it is said to be of, and to no other one."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import trimesh

from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import RigidTransform
from sim.matching.refusal import Refusals
from sim.matching.scene import artefacts
from tests.comparison.test_comparison import BEFORE_CAMERA, CALIBRATION, perfect_cloud

PLACE = RigidTransform(BEFORE_CAMERA[:3, :3], BEFORE_CAMERA[:3, 3])


def roof(ridge_mm: float) -> trimesh.Trimesh:
    """A prism of 32 x 24 mm under a ridge along x."""
    corners = [(x, y, 0.0) for x in (-16, 16) for y in (-12, 12)] + [(x, 0.0, ridge_mm) for x in (-16, 16)]
    return trimesh.convex.convex_hull(np.array(corners))


def fitted(monkeypatch: pytest.MonkeyPatch, scanned: trimesh.Trimesh, said: trimesh.Trimesh) -> Any:
    cloud = perfect_cloud(scanned.copy().apply_transform(BEFORE_CAMERA), noise_mm=0.01)
    monkeypatch.setattr(artefacts, "reconstruct_points", lambda session, calibration: (None, cloud))
    twin = SimpleNamespace(mesh=lambda item: said, pose_of=lambda item: PLACE)
    session = SimpleNamespace(path=Path("scan"))
    return artefacts.fit_scan(cast(Any, twin), "roof", cast(Any, session), CALIBRATION, Refusals(frozenset()))


def test_a_scan_of_the_part_is_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    found = fitted(monkeypatch, roof(8.0), roof(8.0))
    assert found.T_camera_item.translation == pytest.approx(PLACE.translation, abs=0.02)


@pytest.mark.whole
def test_a_scan_of_another_part_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(
        CalibrationError, match=r"scan: its points are \d+ µm off the roof's surface"
    ) as refused:
        fitted(monkeypatch, roof(8.0), roof(7.0))
    assert refused.value.exit_code == 5
