"""What a change of the rig costs, against points that were triangulated with the rig before and after it."""

import numpy as np

from fpplab.calibration.changes import changed_rigs
from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.reconstruction.hidden_changes import HiddenChange, hidden_changes
from fpplab.reconstruction.points import triangulate
from tests.reconstruction.test_triangulation import CALIBRATION, Maps, maps_of, plane

LIMIT_PX = 0.3


def displacements_um(maps: Maps, before: Cloud, after: Calibration) -> float:
    moved = triangulate(maps, after)
    assert np.array_equal(moved.pixels, before.pixels)  # type: ignore[arg-type]
    return 1e3 * float(np.sqrt(np.square(moved.points - before.points).sum(axis=1).mean()))


def hidden(axes: str) -> dict[str, HiddenChange]:
    cloud = triangulate(maps_of(plane(), axes), CALIBRATION)
    noise = tuple(0.01 if axis in axes else np.inf for axis in "xy")
    return {c.meaning: c for c in hidden_changes(cloud, CALIBRATION, noise, LIMIT_PX)}  # type: ignore[arg-type]


def test_along_one_axis_every_change_is_hidden_at_its_whole_cost() -> None:
    maps = maps_of(plane(), "x")
    cloud, costs = triangulate(maps, CALIBRATION), hidden("x")
    for name, rig in changed_rigs(CALIBRATION).items():
        expected = displacements_um(maps, cloud, rig)
        assert abs(costs[name].displacement_um - expected) < 0.05 * expected + 2.0, name
    sizes = [change.displacement_um for change in costs.values()]
    assert sizes == sorted(sizes, reverse=True)


def test_two_axes_exclude_what_leaves_the_epipolar_lines_and_nothing_else() -> None:
    """As by Bayes' rule for one normal variable: 1 / √(1 + (shift / limit)²) of it remains."""
    maps, costs = maps_of(plane()), hidden("xy")
    cloud = triangulate(maps, CALIBRATION)
    for name, rig in changed_rigs(CALIBRATION).items():
        off_px = float(np.sqrt(np.square(triangulate(maps, rig).epipolar_px).mean()))  # type: ignore[arg-type]
        expected = displacements_um(maps, cloud, rig) / np.hypot(1.0, off_px / LIMIT_PX)
        assert abs(costs[name].displacement_um - expected) < 0.05 * expected + 2.0, name
    assert costs["the projector turned by 0.1° about its y axis"].displacement_um > 1000.0
    assert costs["the projector turned by 0.1° about its x axis"].displacement_um < 20.0
