"""Heights over a reference plane, of frames by formula: stated geometry, plates, one set of fringes."""

from typing import Any

import numpy as np
import pytest

from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.diagnosis import Verdict, diagnose_decoded
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded
from fpplab.phase.reference_plane import PlaneGeometry, fit_plates
from fpplab.pipeline.heights import decode_heights, plane_of
from fpplab.reconstruction.points import triangulate

SIZE, DISTANCE_MM, BASELINE_MM, STRIPES = (140, 100), 400.0, 100.0, 57.0
CAMERA = Pinhole.from_focal(SIZE, (300.0, 300.0), (69.5, 49.5))
PROJECTOR = Pinhole.from_focal((912, 1140), (1100.0, 1100.0), (730.5, 569.5))
RIG = Calibration(
    CAMERA, PROJECTOR, RigidTransform.from_vectors(np.zeros(3), np.array([-BASELINE_MM, 0.0, 0.0])), {}
)
PERIOD_MM = 912 / STRIPES * DISTANCE_MM / 1100.0
ONE = [{"axis": "x", "stripes": STRIPES, "steps": 4}]
SEVERAL = [{"axis": "x", "stripes": stripes, "steps": 4} for stripes in (1, 8, STRIPES)]
U, V = np.meshgrid(np.arange(SIZE[0], dtype=float), np.arange(SIZE[1], dtype=float))
DOME: Floats = 2.0 + 0.004 * np.maximum(40.0**2 - (U - 70) ** 2 - (V - 50) ** 2, 0.0)


def geometry(**more: Any) -> PlaneGeometry:
    stated = {"distance_mm": DISTANCE_MM, "baseline_mm": -BASELINE_MM, "period_mm": PERIOD_MM, **more}
    return config.validate(stated, PlaneGeometry, "plane.yaml")


def recorded(height_mm: Floats | float, fringes: list[dict[str, Any]], seed: int) -> Recording:
    unwrapping = "spatial" if len(fringes) == 1 else "hierarchical"
    plan = config.validate({"fringes": fringes, "unwrapping": unwrapping}, Plan, "plan")
    slopes = CAMERA.normalise(np.stack([U, V], axis=-1))
    depth = np.broadcast_to(DISTANCE_MM - np.asarray(height_mm), U.shape)[..., None]
    points = depth * np.concatenate([slopes, np.ones((*U.shape, 1))], axis=-1)
    coordinate = PROJECTOR.project(points, RIG.T_projector_camera)[..., 0]
    random, frames = np.random.default_rng(seed), []
    for each in plan.sets:
        for n in range(each.images):
            level = 40 + 150 * each.light(n, coordinate, PROJECTOR.size[0])
            frames.append(np.rint(level + random.normal(0, 1, level.shape)).astype(np.uint8))
    return Recording(frames, plan, PROJECTOR.size)


def check_heights(decoded: Decoded, truth: Floats) -> None:
    assert decoded.height_mm is not None
    assert decoded.sigma_height_mm is not None
    known = np.isfinite(decoded.height_mm)
    assert known.mean() > 0.9
    error = (decoded.height_mm - truth)[known] / decoded.sigma_height_mm[known]
    assert 0.85 < np.sqrt(np.mean(error**2)) < 1.15
    assert abs(np.mean(error)) < 0.1


def test_heights_are_those_that_triangulation_gives() -> None:
    plane = plane_of(recorded(0.0, SEVERAL, 1), geometry(), [])
    decoded = decode_heights(recorded(DOME, SEVERAL, 2), plane)
    check_heights(decoded, DOME)
    cloud = triangulate(decoded, RIG)
    column, row = cloud.pixels.T
    assert decoded.height_mm is not None
    height = decoded.height_mm[row, column]
    difference = height - (DISTANCE_MM - cloud.points[:, 2])
    assert np.abs(np.mean(difference / height)) < 0.01


@pytest.mark.parametrize("heights_mm", [(0.0, 10.0), None])
def test_one_set_needs_heights_between_which_everything_lies(heights_mm: tuple[float, float] | None) -> None:
    plane = plane_of(recorded(0.0, ONE, 3), geometry(heights_mm=heights_mm), [])
    recording = recorded(DOME, ONE, 4)
    decoded = decode_heights(recording, plane)
    diagnosis = diagnose_decoded(recording, decoded)
    if heights_mm:
        check_heights(decoded, DOME)
        assert diagnosis.verdict is Verdict.UNVERIFIED
        assert "pixels have a height over the plane, with a sigma of" in diagnosis.reason
        assert any(text.startswith("plane: that distance") for text in diagnosis.unknown)
    else:
        assert decoded.height_mm is not None
        assert not np.isfinite(decoded.height_mm).any()
        assert "no pixel has a height" in diagnosis.reason


def test_a_known_height_tells_the_order() -> None:
    plane = plane_of(recorded(0.0, ONE, 3), geometry(), [])
    check_heights(decode_heights(recorded(DOME, ONE, 4), plane, ((70, 50, 8.0),)), DOME)
    with pytest.raises(ConfigError, match="--known: pixel 700, 50 is not measured on frames"):
        decode_heights(recorded(DOME, ONE, 4), plane, ((700, 50, 8.0),))


def test_plates_replace_a_geometry_that_is_roughly_known() -> None:
    stated = geometry(distance_mm=385.0, baseline_mm=-108.0, heights_mm=(0.0, 10.0))
    plates = [(height, recorded(height, ONE, 5 + k)) for k, height in enumerate((4.0, 8.0, 12.0))]
    plane = plane_of(recorded(0.0, ONE, 3), stated, plates)
    decoded = decode_heights(recorded(DOME, ONE, 4), plane)
    assert decoded.height_mm is not None
    assert decoded.sigma_height_mm is not None
    known = np.isfinite(decoded.height_mm)
    error = (decoded.height_mm - DOME)[known]
    assert known.mean() > 0.9
    assert np.abs(np.mean(error / DOME[known])) < 0.005
    # The plane's own noise counts for every plate, as if it were not the same.
    assert 0.7 < np.sqrt(np.mean((error / decoded.sigma_height_mm[known]) ** 2)) < 1.1


def test_plates_give_back_what_made_their_displacements() -> None:
    bend, slope = 0.0025, 4.0
    heights = (3.0, 9.0, 20.0)
    moved = [np.full((2, 2), slope * h / (1 - bend * h)) for h in heights]
    model = fit_plates(heights, moved, [np.full((2, 2), 0.1)] * 3)
    np.testing.assert_allclose(model.bend, bend)
    np.testing.assert_allclose(model.slope, slope)
    np.testing.assert_allclose(model.heights(moved[1], np.zeros((2, 2)))[0], 9.0)


def test_wrong_geometry_and_other_plans_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"plane.yaml: .*'heights_mm': the first must be less"):
        geometry(heights_mm=(5.0, 1.0))
    with pytest.raises(ConfigError, match="'plates' have one height"):
        geometry(plates=[{"session": "a", "height_mm": 4}, {"session": "b", "height_mm": 4}])
    plane = plane_of(recorded(0.0, ONE, 3), geometry(), [])
    with pytest.raises(ConfigError, match="its plan has other sets than frames; record both by one"):
        decode_heights(recorded(0.0, SEVERAL, 3), plane)
