"""Guided unwrapping: orders among the coordinates that the geometry allows."""

import numpy as np
import pytest

from fpplab.core.errors import ConfigError, DataError
from fpplab.patterns.recording import Recording
from fpplab.phase import check_unwrapping, decode
from fpplab.phase.bounds import PossibleCoordinates
from fpplab.phase.unwrapping import wavelength_sequence
from tests.phase.reference_decoder import decode_axis
from tests.phase.test_fusion import WIDTH, plan_of
from tests.phase.test_wrong_order import noisy

GUIDED = plan_of((12.0, 45.0, 167.0), (3, 3, 12), "guided")


@pytest.mark.parametrize("stripes", [(12.0, 45.0, 167.0), (14.0, 100.0), (59.0, 64.0, 70.0)])
def test_orders_are_right_without_a_set_of_one_stripe(stripes: tuple[float, ...]) -> None:
    recording, truth, bounds = noisy(stripes, (4,) * len(stripes), "guided", 30.0, seed=41)
    decoded = decode(recording, bounds=bounds)
    assert decoded.valid.mean() > 0.99
    assert np.nanmax(np.abs(decoded.u - truth)) < 6 * np.nanmax(decoded.sigma)
    known = decode_axis(recording, "x", bounds)
    both = decoded.valid & np.isfinite(known.coordinate)
    assert (decoded.valid == np.isfinite(known.coordinate)).mean() > 0.999
    np.testing.assert_allclose(decoded.u[both], known.coordinate[both], atol=2e-3)


def test_light_from_beyond_the_interval_is_not_measured() -> None:
    recording, truth, bounds = noisy((12.0, 45.0, 167.0), (4, 4, 4), "guided", 60.0, seed=42)
    assert bounds is not None
    off = {
        "x": PossibleCoordinates(
            *(np.clip(end + 70, -0.5, WIDTH - 0.5) for end in (bounds["x"].lower, bounds["x"].upper))
        )
    }
    decoded = decode(recording, bounds=off)
    beyond = truth < off["x"].lower - 2
    right = np.abs(decoded.u - truth) < 1
    assert not (right & beyond).any()


def test_bounds_hold_for_every_method() -> None:
    recording, truth, _ = noisy((1.0, 8.0, 64.0), (12, 12, 12), "hierarchical", 30.0, seed=43)
    least = np.full(truth.shape, 300, np.float32)
    decoded = decode(recording, bounds={"x": PossibleCoordinates(least, least + 300)})
    inside = (truth > 301) & (truth < 599)
    assert decoded.valid[inside].all()
    assert not decoded.valid[(truth < 298) | (truth > 602)].any()


def test_without_geometry_it_is_refused() -> None:
    with pytest.raises(
        ConfigError, match=r"p\.yaml: 'unwrapping' is 'guided', which needs a calibration and a depth"
    ):
        check_unwrapping(GUIDED, "p.yaml")
    frames = [np.zeros((2, WIDTH), np.uint8)] * GUIDED.images
    with pytest.raises(ConfigError, match="'guided', which needs a calibration and a depth range"):
        decode(Recording(frames, GUIDED, (WIDTH, 2)))


def test_a_range_that_is_too_wide_is_refused() -> None:
    check_unwrapping(GUIDED, "plan", {"x": 1 / 12})
    with pytest.raises(
        ConfigError, match=r"at most 10 stripes, and the coarsest here is 12; add one or narrow"
    ):
        check_unwrapping(GUIDED, "plan", {"x": 0.1})


def test_differences_of_sets_serve_where_the_sets_are_too_fine() -> None:
    plan = plan_of((59.0, 64.0, 70.0), (3, 3, 3), "guided")
    assert [w.stripes for w in wavelength_sequence(plan, "x", "plan", 0.08).wavelengths] == [11, 59, 64, 70]
    assert [w.stripes for w in wavelength_sequence(plan, "x", "plan", 0.1).wavelengths] == [6, 11, 59, 64, 70]


def test_bounds_of_another_camera_are_refused() -> None:
    frames = [np.zeros((2, WIDTH), np.uint8)] * GUIDED.images
    maps = np.zeros((3, 3), np.float32)
    with pytest.raises(DataError, match=r"bounds along x are maps of the shape \(3, 3\)"):
        decode(Recording(frames, GUIDED, (WIDTH, 2)), bounds={"x": PossibleCoordinates(maps, maps + 60)})
