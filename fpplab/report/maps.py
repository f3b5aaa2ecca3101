"""Maps of every step of a measurement, as PNG files in memory."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import TWO_PI, Axis, Image, Map, full_scale
from fpplab.core.robust import value_range
from fpplab.report.map_sheet import MAP_PX, MapSheet, draw_maps, drawn_pixels, round_ticks
from fpplab.report.raster import CloudLike, Extent, block_mean, raster_of, rasterise


def camera_image(image: Image, bits: int = 8) -> bytes:
    full = full_scale(bits)
    saturated = image >= full
    share = float(saturated.mean())
    title = f"{saturated.sum():,} saturated pixels ({100 * share:.2g} %)" if share else "no saturated pixels"
    step = max(1, -(-image.shape[1] // MAP_PX))
    size = tuple(-(-length // step) for length in reversed(image.shape))
    shown = cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA).astype(np.float32)
    marks = cv2.dilate(saturated.astype(np.uint8), np.ones((2 * step + 1,) * 2, np.uint8)) > 0
    bright = max(float(np.percentile(shown, 99.8)), 1.0)
    label = f"grey level (full scale {full})"
    edges = (-0.5, image.shape[1] - 0.5, image.shape[0] - 0.5, -0.5)
    return draw_maps(
        MapSheet(shown, "gray", (0.0, bright), label, edges, title=(title,), marked=marks[::step, ::step])
    )


def wrapped_phase_map(phase: Map, extent: Extent | None = None) -> bytes:
    quarters = ("0", "π/2", "π", "3π/2", "2π")
    ticks = [(k * np.pi / 2, name) for k, name in enumerate(quarters)]
    return draw_maps(MapSheet(phase, "twilight", (0.0, TWO_PI), "wrapped phase in rad", extent, ticks=ticks))


def coordinate_map(values: Map, axis: Axis) -> bytes:
    limits = value_range(drawn_pixels(values), 0.1, 99.9)
    label = f"projector {'u' if axis == 'x' else 'v'} in px"
    levels = [level for level, _ in round_ticks(*limits, 14)]
    return draw_maps(MapSheet(values, "viridis", limits, label, contours=levels))


def modulation_map(values: Map) -> bytes:
    upper = value_range(drawn_pixels(values), 0.0, 99.5)[1]
    return draw_maps(MapSheet(values, "inferno", (0.0, upper), "modulation in grey levels of 255"))


def shaded_relief(cloud: CloudLike) -> bytes:
    grid = raster_of(cloud)
    points, extent = rasterise(grid, cloud.points)
    return draw_maps(MapSheet(surface_shading(points), "gray", (0.0, 1.0), extent=extent, axes=grid.names))


def depth_map(cloud: CloudLike) -> bytes:
    return point_map(cloud, cloud.points[:, 2], "viridis_r", "distance z from the camera in mm")


def point_map(
    cloud: CloudLike,
    values: NDArray[np.floating[Any]],
    colours: str,
    label: str,
    limits: tuple[float, float] | None = None,
) -> bytes:
    # values (N,)
    grid = raster_of(cloud)
    mapped, extent = rasterise(grid, np.asarray(values, np.float32)[:, None])
    shown = limits or value_range(drawn_pixels(mapped), 0.5, 99.5)
    return draw_maps(MapSheet(mapped[..., 0], colours, shown, label, extent, grid.names))


def thumbnail(cloud: CloudLike, width_px: int = 232) -> bytes:
    bright = np.nan_to_num(surface_shading(rasterise(raster_of(cloud), cloud.points)[0]), nan=0.85)
    height = max(1, min(2 * width_px, round(width_px * bright.shape[0] / bright.shape[1])))
    small = cv2.resize(bright, (width_px, height), interpolation=cv2.INTER_AREA).astype(np.float32)
    return bytes(cv2.imencode(".png", (255 * small).astype(np.uint8))[1])


def surface_shading(points: Map) -> Map:
    # points (h, w, 3) mm
    coarse = block_mean(points, 760)  # of about 760 columns: a mean reduces the noise of the normals
    measured = np.isfinite(coarse[..., 0])
    if min(measured.shape) < 2:  # one line of pixels has no normals
        return np.where(measured, np.float32(0.5), np.float32(np.nan))
    weight = cv2.GaussianBlur(measured.astype(np.float32), (0, 0), 1.2)
    smooth = cv2.GaussianBlur(np.nan_to_num(coarse), (0, 0), 1.2) / np.maximum(weight, 1e-6)[..., None]
    (ax, ay, az), (dx, dy, dz) = (
        cv2.split(cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=1, borderType=cv2.BORDER_REPLICATE))
        for order in ((1, 0), (0, 1))
    )
    x, y, z = ay * dz - az * dy, az * dx - ax * dz, ax * dy - ay * dx
    towards_camera = -np.sign(z) / np.maximum(np.sqrt(x * x + y * y + z * z), np.float32(1e-12))
    light = np.array([-0.55, -0.65, -0.8]) / np.linalg.norm([-0.55, -0.65, -0.8])
    halfway = (light + [0.0, 0.0, -1.0]) / np.linalg.norm(light + [0.0, 0.0, -1.0])
    matt, gloss = (
        np.clip((x * a + y * b + z * c) * towards_camera, 0, 1)
        for a, b, c in (light.tolist(), halfway.tolist())
    )
    return np.where(measured, 0.08 + 0.80 * matt + 0.12 * cv2.pow(gloss, 24), np.float32(np.nan))
