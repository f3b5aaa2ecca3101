"""A point cloud that a page draws by WebGL (`templates/cloud_view.js`), with a still picture for print."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fpplab.clouds import Cloud
from fpplab.core.conventions import Floats
from fpplab.report.map_sheet import colour_table, draw_picture
from fpplab.report.wording import count_text

if TYPE_CHECKING:
    from fpplab.comparison import Comparison

MAX_POINTS = 60_000  # of a view (chosen: some megabytes); a page with several shares twice as many
TILT_DEG, TURN_DEG = 50.0, 25.0
"""The view at first: tilted away from the camera's own by this, and turned about the camera's axis."""
FIELD_DEG = 30.0  # vertical field of view (chosen)
FILLED = 0.92  # share of the still picture and of the canvas that the points take at first (chosen)
STILL = (960, 600)  # width and height of the still picture in px
STEPS = 65535  # steps of a quantised value, those of 16 bits; 0 is a value that is not known
GREY = 0.6  # colour of points without a value: red, green and blue as a share of full brightness (chosen)


@dataclass(frozen=True, eq=False)
class CloudQuantity:
    """What colours the points of a view."""

    name: str  # of the quantity, in the list of colours
    unit: str  # of its values
    values: NDArray[np.float32]  # naN where it is not known
    low: float  # values of the first and the last colour
    high: float  # values of the first and the last colour
    colours: str  # name of the colour map

    @classmethod
    def of(
        cls, name: str, unit: str, values: NDArray[Any], colours: str, symmetric: bool = False
    ) -> CloudQuantity:
        # values (N,)
        finite = values[np.isfinite(values)]
        if symmetric:
            high = max(float(np.percentile(np.abs(finite), 98)), 1e-6)
            return cls(name, unit, values.astype(np.float32), -high, high, colours)
        low, high = (float(x) for x in np.percentile(finite, (1, 99)))
        return cls(name, unit, values.astype(np.float32), low, max(high, low + 1e-6), colours)

    @property
    def label(self) -> str:
        return f"{self.name} in {self.unit}"

    def quantised(self) -> NDArray[np.uint16]:
        # returns (N,)
        share = np.clip((self.values - self.low) / (self.high - self.low), 0.0, 1.0)
        return np.where(np.isfinite(share), 1 + np.nan_to_num(share) * (STEPS - 1), 0).astype("<u2")


@dataclass(frozen=True)
class CloudView:
    """A cloud as a page holds it."""

    name: str  # of the object
    described: str  # JSON for the page's script
    packed: str  # base64 of positions (N
    still: str  # PNG file of the first view as base64
    alt: str  # what it shows
    caption: str  # below it


def cloud_view(
    name: str, cloud: Cloud, comparison: Comparison | None = None, max_points: int = MAX_POINTS
) -> CloudView:
    errors = None if comparison is None else np.where(comparison.counted, comparison.distances_mm, np.nan)
    kept = decimate(cloud, max_points)
    shown = cloud.only(kept)
    quantities = _quantities(shown, None if errors is None else errors[kept])
    (centre, radius), spacing = _centre_and_radius(shown.points), _spacing(shown)
    left_out = len(cloud) - int(np.count_nonzero(_drop_far_points(cloud.points)))
    caption = f"{count_text(len(shown))} of {count_text(len(cloud))} points."
    if left_out:
        caption += f" {count_text(left_out)} points far from all others are not shown."
    first = quantities[0]
    still = draw_picture(
        _point_colours(shown, first, centre, radius, spacing),
        first.colours,
        (first.low, first.high),
        first.label,
    )
    return CloudView(
        name,
        _described(shown, quantities, centre, radius, spacing),
        base64.b64encode(_pack_points(shown, quantities)).decode("ascii"),
        base64.b64encode(still).decode("ascii"),
        f"The points of the {name} seen obliquely, coloured by {quantities[0].label}",
        caption,
    )


def decimate(cloud: Cloud, max_points: int) -> NDArray[np.bool_]:
    """Choose points that represent a cloud: every k-th column and row of the camera, or every k-th point."""
    # returns (N,)
    near = _drop_far_points(cloud.points)
    if cloud.pixels is not None:
        u, v = cloud.pixels.T
        for step in range(max(1, int(np.sqrt(near.sum() / max_points))), 1 << 16):
            kept = near & (u % step == 0) & (v % step == 0)
            if 0 < kept.sum() <= max_points:
                return np.asarray(kept)
            if not kept.any():
                break
    rows = np.flatnonzero(near)
    kept = np.zeros(len(cloud), np.bool_)
    kept[rows[:: -(-len(rows) // max_points)]] = True
    return kept


def _drop_far_points(points: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Points that lie within the middle 99 % of all, or no farther from them than half of their range."""
    some = np.ascontiguousarray(points[:: max(1, len(points) // MAX_POINTS)].T)
    low, high = np.percentile(some, (0.5, 99.5), axis=1).astype(np.float32)
    reach = 0.5 * (high - low) + 1e-3
    return np.asarray(((points >= low - reach) & (points <= high + reach)).all(axis=1))


def _quantities(cloud: Cloud, errors_mm: NDArray[Any] | None) -> list[CloudQuantity]:
    quantities = []
    if errors_mm is not None and np.isfinite(errors_mm).any():
        quantities.append(CloudQuantity.of("Signed error", "µm", 1e3 * errors_mm, "RdBu_r", symmetric=True))
    quantities.append(
        CloudQuantity.of("Height: distance from the camera", "mm", cloud.points[:, 2], "viridis_r")
    )
    sigma = cloud.sigma_along_ray_mm if cloud.sigma_mm is None else cloud.sigma_mm
    if sigma is not None and np.isfinite(sigma).any():
        quantities.append(CloudQuantity.of("Standard uncertainty", "µm", 1e3 * sigma, "cividis"))
    if cloud.colour is not None:
        quantities.append(CloudQuantity.of("Intensity", "grey levels", cloud.colour, "gray"))
    return quantities


def _centre_and_radius(points: NDArray[np.float32]) -> tuple[Floats, float]:
    low, high = np.percentile(points.astype(np.float64), (0.5, 99.5), axis=0)
    return (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-3)


def _outline(points: NDArray[np.float32], centre: Floats) -> Floats:
    """Points that are outermost in many directions, about the centre: x right, y up, z towards the eye."""
    away = ((points - centre) * [1, -1, -1]).astype(np.float32)
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 5, dtype=np.float32)] * 3), axis=-1).reshape(-1, 3)
    return np.asarray(away[np.unique(np.argmax(away @ grid.T, axis=0))], np.float64)


def _frame(outline: Floats, radius: float) -> tuple[Floats, float]:
    """Pan and distance at which points nearly fill the still picture, as the page's script finds them."""
    turned = outline @ _first_turn().T
    half = np.tan(np.radians(FIELD_DEG) / 2)
    reach = FILLED * half * np.array([STILL[0] / STILL[1], 1.0])
    pan, distance = np.zeros(2), 4 * radius
    for _ in range(30):
        seen = (turned[:, :2] + pan) / (distance - turned[:, 2:])
        low, high = seen.min(axis=0), seen.max(axis=0)
        pan = pan - distance * (low + high) / 2
        distance = max(distance * float(np.max((high - low) / 2 / reach)), 1.2 * radius)
    return pan, distance


def _described(
    cloud: Cloud, quantities: list[CloudQuantity], centre: Floats, radius: float, spacing: float
) -> str:
    low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
    return json.dumps(
        {
            "points": len(cloud),
            "low": low.tolist(),
            "size": (high - low).tolist(),
            "centre": centre.tolist(),
            "radius": radius,
            "outline": _outline(cloud.points, centre).round(4).tolist(),
            "filled": FILLED,
            "spacing": spacing,
            "tilt": np.radians(TILT_DEG),
            "turn": np.radians(TURN_DEG),
            "field": np.radians(FIELD_DEG),
            "grey": GREY,
            "normals": cloud.normals is not None,
            "quantities": [
                {
                    "label": quantity.label,
                    "name": quantity.name,
                    "unit": quantity.unit,
                    "low": quantity.low,
                    "high": quantity.high,
                    "colours": _colours(quantity.colours),
                }
                for quantity in quantities
            ],
        }
    ).replace("<", "\\u003c")


def _colours(name: str) -> str:
    """256 colours as base64 of RGB bytes."""
    return base64.b64encode(colour_table(name).tobytes()).decode()


def _spacing(cloud: Cloud) -> float:
    points = cloud.points
    if len(points) < 2:
        return 1.0
    if cloud.pixels is not None:  # in order, so that the next point is mostly a neighbour
        return max(float(np.median(np.linalg.norm(np.diff(points, axis=0), axis=1))), 1e-6)
    some = points[:: max(1, len(points) // 2000)]
    from scipy.spatial import cKDTree

    return max(float(np.median(cKDTree(points).query(some, k=2)[0][:, 1])), 1e-6)


def _pack_points(cloud: Cloud, quantities: list[CloudQuantity]) -> bytes:
    low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
    share = (cloud.points - low) / np.maximum(high - low, 1e-9)
    parts = [np.rint(share * STEPS).astype("<u2").tobytes()]
    parts += [quantity.quantised().tobytes() for quantity in quantities]
    if cloud.normals is not None:
        parts.append(np.rint(127 * cloud.normals).astype(np.int8).tobytes())
    return b"".join(parts)


def _point_colours(
    cloud: Cloud, quantity: CloudQuantity, centre: Floats, radius: float, spacing: float
) -> Floats:
    turned = _towards_eye(cloud.points - centre)
    width, height = STILL
    focal = 0.5 * height / np.tan(np.radians(FIELD_DEG) / 2)
    pan, distance = _frame(_outline(cloud.points, centre), radius)
    depth = distance - turned[:, 2]
    side = int(np.clip(np.ceil(1.6 * focal * spacing / np.median(depth)), 1, 12))
    offsets = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2) - side // 2
    place = np.rint(((turned[:, :2] + pan) * [1, -1]) * (focal / depth)[:, None]).astype(int)
    order = np.argsort(-depth, kind="stable")
    x, y = ((place[order] + [width // 2, height // 2])[:, None] + offsets).reshape(-1, 2).T
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    picture = np.ones((height, width, 3))
    # Of points at one place the last is kept, which is the nearest.
    picture[y[inside], x[inside]] = np.repeat(_point_shades(cloud, quantity)[order], len(offsets), axis=0)[
        inside
    ]
    return picture


def _point_shades(cloud: Cloud, quantity: CloudQuantity) -> Floats:
    share = np.clip((quantity.values - quantity.low) / (quantity.high - quantity.low), 0, 1)
    colours = colour_table(quantity.colours)[np.rint(255 * np.nan_to_num(share)).astype(np.uint8)] / 255.0
    colours[~np.isfinite(share)] = GREY
    if cloud.normals is None:
        return np.asarray(colours)
    light = np.array([-0.35, 0.5, 0.79])
    return np.asarray(colours * (0.45 + 0.55 * np.abs(_towards_eye(cloud.normals) @ light))[:, None])


def _towards_eye(vectors: NDArray[Any]) -> Floats:
    """Turn vectors of the camera's frame as the first view does: x right, y up, z towards the eye."""
    return np.asarray((np.asarray(vectors, np.float64) * [1, -1, -1]) @ _first_turn().T)


def _first_turn() -> Floats:
    tilt, turn = np.radians(TILT_DEG), np.radians(TURN_DEG)
    about_z = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    about_x = np.array([[1, 0, 0], [0, np.cos(tilt), np.sin(tilt)], [0, -np.sin(tilt), np.cos(tilt)]])
    return np.asarray(about_x @ about_z)
