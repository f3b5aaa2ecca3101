"""A scan is fitted to the part that it is said to be of, and to no other one."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import trimesh

from fpplab.clouds import Cloud
from fpplab.comparison.visibility import RayTracedShape
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import RigidTransform
from fpplab.matching import artefacts
from fpplab.matching.refusal import Refusals
from tests.support.plane_twin import CAMERA, nominal, tilted

PLACE = RigidTransform(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 450.0]))
"""The part's z axis towards the camera."""
KNOWN = nominal(tilted(1)).calibration


def roof(ridge_mm: float) -> trimesh.Trimesh:
    """A prism of 32 x 24 mm under a ridge along x."""
    corners = [(x, y, 0.0) for x in (-16, 16) for y in (-12, 12)] + [(x, 0.0, ridge_mm) for x in (-16, 16)]
    return trimesh.convex.convex_hull(np.array(corners))


def cloud_of(part: trimesh.Trimesh) -> Cloud:
    """A point where each pixel sees the part, with noise along its ray."""
    width, height = CAMERA.size
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).reshape(-1, 2)
    rays = np.concatenate([CAMERA.normalise(pixels.astype(float)), np.ones((len(pixels), 1))], axis=-1)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    shape = RayTracedShape(part.copy().apply_transform(PLACE.matrix))
    depth = shape.depth(np.zeros(3), rays) + np.random.default_rng(1).normal(0, 0.01, len(rays))
    seen = np.isfinite(depth)
    points = (depth[seen, None] * rays[seen]).astype(np.float32)
    return Cloud(points, pixels=pixels[seen].astype(np.int32), size=CAMERA.size)


def fitted(monkeypatch: pytest.MonkeyPatch, scanned: trimesh.Trimesh, said: trimesh.Trimesh) -> Any:
    monkeypatch.setattr(artefacts, "reconstruct", lambda session, calibration: (None, cloud_of(scanned)))
    twin = SimpleNamespace(mesh=lambda item: said, pose_of=lambda item: PLACE)
    session = SimpleNamespace(path=Path("scan"))
    return artefacts.fit_scan(cast(Any, twin), "roof", cast(Any, session), KNOWN, Refusals(frozenset()))


def test_a_scan_of_the_part_is_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    found = fitted(monkeypatch, roof(8.0), roof(8.0))
    assert found.T_camera_item.translation == pytest.approx(PLACE.translation, abs=0.02)


def test_a_scan_of_another_part_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(CalibrationError, match=r"scan: its points are \d+ µm off the roof's surface"):
        fitted(monkeypatch, roof(8.0), roof(7.0))
