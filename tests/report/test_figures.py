"""Figures show what they are given: colours, marks, shading and ranges are read back from the PNG file."""

import io
from types import SimpleNamespace
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from PIL import Image as Pixels

from fpplab.core.drawing import ALARM
from fpplab.core.errors import DataError
from fpplab.core.robust import error_limit
from fpplab.patterns.curve import Curve
from fpplab.report import figures, maps, response_figures
from fpplab.report.map_sheet import MapSheet, colour_table, draw_maps, round_ticks
from fpplab.report.raster import block_mean, raster_of, rasterise

SIZE = (64, 48)
LIGHT = np.array([-0.55, -0.65, -0.8]) / np.linalg.norm([-0.55, -0.65, -0.8])


def rgb(png: bytes) -> NDArray[np.int64]:
    """The picture as (h, w, 3)."""
    return np.asarray(Pixels.open(io.BytesIO(png)).convert("RGB")).astype(np.int64)


def cloud(with_pixels: bool = True) -> Any:
    """A plane at z = 400 mm, 0.5 mm per pixel."""
    v, u = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
    points = np.stack([0.5 * u, 0.5 * v, np.full(u.shape, 400.0)], axis=-1).reshape(-1, 3).astype(np.float32)
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2).astype(np.int32)
    return SimpleNamespace(points=points, pixels=pixels if with_pixels else None, size=SIZE)


def tilted(slope_x: float, slope_y: float) -> NDArray[np.float32]:
    """A plane (h, w, 3) that goes away from the camera by these slopes."""
    v, u = np.mgrid[0.0:40.0, 0.0:50.0]
    return np.asarray(np.stack([u, v, 400 + slope_x * u + slope_y * v], axis=-1), np.float32)


@pytest.mark.parametrize("slopes", [(0.0, 0.0), (0.5, 0.0), (0.0, -0.7), (-0.4, 0.9)])
def test_shading_of_a_plane_follows_the_reflection_model(slopes: tuple[float, float]) -> None:
    normal = np.array([*slopes, -1.0]) / np.linalg.norm([*slopes, 1.0])
    halfway = (LIGHT + [0, 0, -1]) / np.linalg.norm(LIGHT + [0, 0, -1])
    expected = 0.08 + 0.80 * max(normal @ LIGHT, 0.0) + 0.12 * max(normal @ halfway, 0.0) ** 24
    # Blurring is one-sided within four pixels of the edge, which does not tilt a plane but shortens it.
    assert maps.surface_shading(tilted(*slopes))[8:-8, 8:-8] == pytest.approx(expected, abs=2e-4)


def test_a_surface_facing_the_light_is_brighter() -> None:
    away, towards = (np.nanmedian(maps.surface_shading(tilted(s, 0.0))) for s in (0.6, -0.6))
    assert away < towards


def test_the_relief_is_empty_where_nothing_was_measured() -> None:
    points = tilted(0.2, 0.1)
    points[10:20, 15:30] = np.nan
    shade = maps.surface_shading(points)
    assert np.array_equal(np.isnan(shade), np.isnan(points[..., 0]))


def test_errors_are_red_outside_and_blue_inside() -> None:
    plane = cloud()
    distances = np.where(plane.pixels[:, 0] < SIZE[0] // 2, 0.02, -0.02)
    picture = rgb(figures.error_map(plane, distances))
    middle = picture[picture.shape[0] // 2]
    redness = middle[:, 0] - middle[:, 2]
    columns = np.flatnonzero(np.abs(redness) > 60)
    map_columns = columns[columns < 0.55 * len(middle)]
    assert redness[map_columns[5]] > 60
    assert redness[map_columns[len(map_columns) * 3 // 4]] < -60


def test_points_that_are_not_counted_are_left_out() -> None:
    plane = cloud()
    distances = np.where(plane.pixels[:, 0] < 32, 0.02, -0.02)
    counted = plane.pixels[:, 0] < 32
    picture = rgb(figures.error_map(plane, distances, counted))[:, : int(0.5 * 1536)]
    assert np.sum(picture[..., 0] - picture[..., 2] > 60) > 1000
    # The colour bar alone is blue in the left half of the sheet.
    alone = rgb(figures.error_map(plane, distances))[:, : int(0.5 * 1536)]
    blue = [int(np.sum(p[..., 2] - p[..., 0] > 60)) for p in (picture, alone)]
    assert blue[0] < 0.2 * blue[1]


def test_a_cloud_without_pixels_is_drawn_too() -> None:
    plane = cloud(with_pixels=False)
    picture = rgb(figures.error_map(plane, np.full(len(plane.points), 0.01)))
    assert np.sum(picture[..., 0] - picture[..., 2] > 60) > 1000


@pytest.mark.parametrize("distances", [np.full(SIZE[0] * SIZE[1], np.nan), np.zeros(3)])
def test_errors_that_cannot_be_drawn_are_refused(distances: NDArray[np.float64]) -> None:
    with pytest.raises(DataError, match="nothing to draw"):
        figures.error_map(cloud(), distances)


@pytest.mark.parametrize(("bits", "full"), [(8, 255), (10, 1023), (12, 4095)])
def test_saturated_pixels_are_marked_at_any_depth(bits: int, full: int) -> None:
    image: Any = np.full((48, 64), full - 1, np.uint16 if bits > 8 else np.uint8)
    alarm = np.array([int(ALARM[i : i + 2], 16) for i in (1, 3, 5)])

    def marked() -> int:
        return int(np.sum(np.abs(rgb(maps.camera_image(image, bits)) - alarm).max(-1) < 12))

    assert marked() == 0
    image[20:28, 30:40] = full
    assert marked() > 1000


def test_the_cyclic_colour_map_is_continuous_at_zero() -> None:
    colours = mpl.colormaps["twilight"]([0.0, 1.0])
    assert colours[0] == pytest.approx(colours[1], abs=0.01)
    phase = np.full((48, 64), 0.01, np.float32)
    phase[:, ::2] = 2 * np.pi - 0.01
    picture = rgb(maps.wrapped_phase_map(phase))
    height, width = picture.shape[:2]
    inside = picture[height // 3 : height // 2, width // 4 : width // 2]
    assert inside.reshape(-1, 3).std(0).max() < 3


@pytest.mark.parametrize("draw", [maps.modulation_map, lambda m: maps.coordinate_map(m, "x")])
def test_an_empty_map_is_refused(draw: Any) -> None:
    with pytest.raises(DataError, match="no measured pixel"):
        draw(np.full((20, 30), np.nan, np.float32))


def test_drawing_does_not_change_matplotlib_settings() -> None:
    before = dict(mpl.rcParams)
    ramp = np.tile(np.arange(64, dtype=np.float32), (48, 1))
    assert maps.coordinate_map(ramp, "y") == maps.coordinate_map(ramp, "y")
    assert dict(mpl.rcParams) == before


def test_all_other_figures_are_drawn() -> None:
    rng = np.random.default_rng(3)
    pixels = rng.uniform(0, 47, (30, 2))
    response = Curve(a=0.9, b=0.02, g=2.2)
    levels = np.linspace(0, 1, 9)
    pictures = [
        maps.shaded_relief(cloud()),
        maps.depth_map(cloud()),
        figures.residuals_figure(pixels, rng.normal(0, 0.05, (30, 2)), SIZE, "camera"),
        figures.draw_coverage([pixels[:15], pixels[15:]], SIZE, "projector"),
        response_figures.response_curve(response, np.stack([levels, 0.9 * levels**2.2 + 0.02], axis=1)),
        figures.pose_rms(["a", "b"], [0.05, 0.06], [0.07, 0.08]),
    ]
    for png in pictures:
        assert rgb(png).std() > 5


def test_residuals_without_points_are_refused() -> None:
    with pytest.raises(DataError, match="camera: 0 residuals"):
        figures.residuals_figure(np.empty((0, 2)), np.empty((0, 2)), SIZE, "camera")


def test_the_colour_range_holds_98_per_cent() -> None:
    errors = np.append(np.random.default_rng(1).normal(0, 10, 10_000), [np.nan, 1e6])
    limit = error_limit(errors)
    assert np.mean(np.abs(errors[:-2]) <= limit) == pytest.approx(0.98, abs=2e-4)


def test_points_lie_where_their_pixels_are() -> None:
    plane = cloud()
    mapped, extent = rasterise(raster_of(plane), plane.points)
    # A margin of 4 % of the map is wider than the strays, so that the whole sensor is there.
    assert extent == (-0.5, SIZE[0] - 0.5, SIZE[1] - 0.5, -0.5)
    assert np.array_equal(mapped.reshape(-1, 3), plane.points)


def test_a_map_is_cropped_to_its_object() -> None:
    pixels = np.array([(u, v) for v in range(500, 540) for u in range(300, 360)] + [(0, 0)], np.int32)
    points = np.ones((len(pixels), 3), np.float32)
    mapped, extent = rasterise(raster_of(SimpleNamespace(points=points, pixels=pixels)), points)
    assert mapped.shape[0] < 50
    assert 295 < extent[0] < 300
    assert 539 < extent[2] < 545


def test_points_without_pixels_keep_their_millimetres() -> None:
    plane = cloud(with_pixels=False)
    mapped, (left, right, bottom, top) = rasterise(raster_of(plane), plane.points)
    height, width = mapped.shape[:2]
    v, u = np.nonzero(np.isfinite(mapped[..., 0]))
    x = left + (u + 0.5) * (right - left) / width
    y = top + (v + 0.5) * (bottom - top) / height
    assert np.abs(mapped[v, u, 0] - x).max() < 0.51 * (right - left) / width
    assert np.abs(mapped[v, u, 1] - y).max() < 0.51 * (bottom - top) / height


@given(level=st.floats(-1e3, 1e3), holes=st.integers(0, 2**16), columns=st.integers(3, 30))
def test_block_means_of_a_constant_are_that_constant(level: float, holes: int, columns: int) -> None:
    values = np.full((30, 40), level, np.float32)
    values[np.random.default_rng(holes).random(values.shape) < 0.3] = np.nan
    mean = block_mean(values, columns)
    assert mean[np.isfinite(mean)] == pytest.approx(np.float32(level), rel=1e-6, abs=1e-6)


def test_block_means_need_half_a_block() -> None:
    nan = np.nan
    values = np.array([[1, 3, 5, nan, 4, nan], [1, 3, nan, nan, 6, nan]], np.float32)
    assert np.array_equal(block_mean(values, 3), np.array([[2.0, nan, 5.0]], np.float32), equal_nan=True)


@pytest.mark.whole_after(2)
@pytest.mark.parametrize("points", [1, 2, 1500])
def test_a_line_of_points_is_drawn(points: int) -> None:
    pixels = np.stack([np.arange(points), np.full(points, 7)], axis=1).astype(np.int32)
    line = SimpleNamespace(points=np.full((points, 3), 400, np.float32), pixels=pixels)
    for png in (
        maps.shaded_relief(line),
        maps.depth_map(line),
        figures.error_map(line, np.full(points, 0.01)),
    ):
        assert rgb(png).std() > 5


@pytest.mark.parametrize("name", ["viridis", "viridis_r", "cividis", "inferno", "twilight", "gray", "RdBu_r"])
def test_colours_are_those_of_figures(name: str) -> None:
    figure = mpl.colormaps[name](np.linspace(0, 1, 256), bytes=True)[:, :3].astype(int)
    assert np.abs(colour_table(name) - figure).max() <= 3


def test_a_map_has_its_colours_and_round_numbers() -> None:
    assert round_ticks(-0.5, 1687.5, 4) == [(0.0, "0"), (500.0, "500"), (1000.0, "1000"), (1500.0, "1500")]
    assert round_ticks(-0.06, 0.06, 4)[0] == (-0.05, "\N{MINUS SIGN}0.05")
    values = np.tile(np.linspace(0, 1, 600, dtype=np.float32), (400, 1))
    values[100:200] = np.nan
    picture = rgb(draw_maps(MapSheet(values, "viridis", (0.0, 1.0), axes=None)))
    table = colour_table("viridis")
    assert np.abs(picture[50, [5, 300, 595]] - table[[2, 127, 253]]).max() <= 8
    assert picture[150, 300].tolist() == [0xB9, 0xBC, 0xC0]


def test_scattered_pixels_need_no_contours() -> None:
    values = np.full((800, 1200), np.nan, np.float32)
    values[::40, ::40] = 5.0
    values[0, 0] = 300.0
    assert rgb(maps.coordinate_map(values, "x")).std() > 5


def test_mismatched_marker_levels_are_drawn_in_the_alarm_colour() -> None:
    shown = np.array([160, 0, 110, 255])
    in_step, late = shown / 300.0, np.array([0.0, 160, 0, 110]) / 300.0
    alarm = np.array([int(ALARM[i : i + 2], 16) for i in (1, 3, 5)])

    def alarmed(levels: NDArray[np.float64]) -> int:
        picture = rgb(response_figures.marker_levels(shown, {"stepped": levels}))
        return int((np.abs(picture - alarm).sum(axis=2) < 40).sum())

    assert alarmed(late) > 2 * alarmed(in_step)
