"""Point clouds with attributes of each point, as tables, drawings, and objects of other libraries."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import prange
from numpy.typing import NDArray

from fpplab.clouds.pixelgrid import PixelGrid, are_within
from fpplab.clouds.selection import are_finite, select_rows
from fpplab.core import buffers
from fpplab.core.compiled import kernel
from fpplab.core.conventions import Floats, Map, Mask
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.extras import need_extra
from fpplab.core.notebook import axes_or_new, grey_picture, html_table, plot_map

if TYPE_CHECKING:
    import trimesh
    from matplotlib.axes import Axes

CloudPoints = NDArray[np.float32]  # values of every point of a cloud, (N,) or (N, 3)

SIGMAS = ("sigma_noise_mm", "sigma_phase_error_mm", "sigma_calibration_mm", "sigma_form_mm")
_AXES = ("x", "y", "z")
_PLOTTED = ("colour", "sigma_mm", *SIGMAS, "epipolar_px")  # attributes of one value for each point


@dataclass(frozen=True, eq=False)
class Cloud:
    """A point cloud in mm in the camera's frame; attributes that are not known are None.

    The two uncertainties from the calibration are root mean square distances
    (`fpplab.reconstruction.uncertainty`).

    Attributes
    ----------
    points : ndarray of float32
        (N, 3) in mm, at least one, all finite.
    pixels : ndarray of int32, optional
        Camera pixels (N, 2) as (u, v), at most one point per pixel.
    size : tuple of int, optional
        Width and height in px of the camera that `pixels` refers to.
    normals : ndarray of float32, optional
        Unit normals (N, 3) facing the camera, (0, 0, 0) where unknown.
    colour : ndarray of uint8, optional
        Grey levels (N,).
    rgb : ndarray of uint8, optional
        Red, green and blue (N, 3) of a camera that sees colours, in proportion to light.
    sigma_noise_mm : ndarray of float32, optional
        Standard uncertainty (N,) in mm from the noise of the fringes, along the ray, independent between
        points.
    sigma_calibration_mm : ndarray of float32, optional
        Standard uncertainty (N,) in mm from the calibration's covariance, common to all points.
    sigma_form_mm : ndarray of float32, optional
        What the best rigid motion of the whole cloud leaves of `sigma_calibration_mm`, (N,) in mm.
    epipolar_px : ndarray of float32, optional
        Distance (N,) from the epipolar curve in projector px.
    sigma_phase_error_mm : ndarray of float32, optional
        Standard uncertainty (N,) in mm from errors of the phase that are common to all points of one phase
        (response, lamp, rounding of grey levels), along the ray.
    origin_mm : tuple of float
        What `coordinates` adds to `points`, where these lie too far from 0 for numbers of 32 bits.

    Raises
    ------
    DataError
        The arrays' shapes do not fit together, there is no point, a point is not finite, pixels lie outside
        the image, or only one of `pixels` and `size` is given.
    """

    points: CloudPoints
    pixels: NDArray[np.int32] | None = None
    size: tuple[int, int] | None = None
    normals: CloudPoints | None = None
    colour: NDArray[np.uint8] | None = None
    sigma_noise_mm: CloudPoints | None = None
    sigma_calibration_mm: CloudPoints | None = None
    sigma_form_mm: CloudPoints | None = None
    epipolar_px: CloudPoints | None = None
    sigma_phase_error_mm: CloudPoints | None = None
    origin_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rgb: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        n = len(self.points)
        shapes: dict[str, tuple[int, ...]] = {
            "points": (n, 3),
            "pixels": (n, 2),
            "normals": (n, 3),
            "rgb": (n, 3),
        }
        shapes |= dict.fromkeys(("colour", *SIGMAS, "epipolar_px"), (n,))
        for name, shape in shapes.items():
            values = getattr(self, name)
            if values is not None and values.shape != shape:
                raise DataError(f"cloud: {name} has the shape {values.shape} instead of {shape}")
        if n == 0 or not are_finite(self.points):
            raise DataError("cloud: there must be at least one point, and all must be finite")
        if (self.pixels is None) != (self.size is None):
            raise DataError("cloud: 'pixels' and 'size' must be given together")
        if self.pixels is None or self.size is None:
            return
        if not are_within(self.pixels, *self.size):
            raise DataError(f"cloud: pixels lie outside the camera's {self.size}")

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        attributes = [
            name for name in ("pixels", "normals", "colour", *SIGMAS) if getattr(self, name) is not None
        ]
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        extent = " x ".join(f"{length:.1f}" for length in high - low)
        return f"<Cloud: {len(self)} points, {extent} mm{'; ' * bool(attributes)}{', '.join(attributes)}>"

    def _repr_html_(self) -> str:
        low, high = self.points.min(axis=0), self.points.max(axis=0)
        rows: dict[str, object] = {"points": f"{len(self):,}"}
        rows |= {name: f"{a:.2f} … {b:.2f} mm" for name, a, b in zip(("x", "y", "z"), low, high, strict=True)}
        rows["camera"] = f"{self.size[0]} x {self.size[1]} px" if self.size else None
        for name in ("sigma_mm", *SIGMAS):
            values = getattr(self, name)
            rows[name] = None if values is None else f"median {1e3 * float(np.median(values)):.1f} µm"
        rows["normals"] = "known" if self.normals is not None else None
        picture = grey_picture(-self.map_of(self.points[:, 2])) if self.size else None
        return html_table("Cloud", rows, picture)

    def map_of(self, values: str | NDArray[Any]) -> Map:
        """Arrange values of the points over the camera's pixels.

        Parameters
        ----------
        values : str or ndarray
            One (N,) for each point, or the name of such an attribute, as `plot` takes it: "z" or
            "sigma_noise_mm", say.

        Returns
        -------
        ndarray of float32, (height, width)
            Indexed [v, u], NaN where there is no point.

        Raises
        ------
        ConfigError
            There is no attribute of this name.
        DataError
            The pixels of the points or the attribute are not known, or there are more or fewer values.
        """
        if self.pixels is None or self.size is None:
            raise DataError("cloud: its points are not known by camera pixel; use a cloud that fpplab made")
        if isinstance(values, str):
            values = self._named(values)
        if values.shape != (len(self),):
            raise DataError(f"cloud: values of {values.shape} do not fit {len(self)} points")
        arranged = np.full((self.size[1], self.size[0]), np.nan, np.float32)
        arranged[self.pixels[:, 1], self.pixels[:, 0]] = values
        return arranged

    def plot(self, values: str = "z", axes: Axes | None = None) -> Axes:
        """Draw the cloud, coloured: over the camera's pixels, or from the camera where they are not known.

        Parameters
        ----------
        values : str
            What gives the colour: "x", "y", "z", or an attribute of one value for each point that is
            known: "colour", "sigma_mm", "sigma_noise_mm", "sigma_phase_error_mm", "sigma_calibration_mm",
            "sigma_form_mm" or "epipolar_px".
        axes : matplotlib.axes.Axes, optional
            Where to draw; new ones by default.

        Returns
        -------
        matplotlib.axes.Axes
            With the drawing.

        Raises
        ------
        ConfigError
            There is no such attribute.
        DataError
            The cloud does not hold it; the message names what it holds.
        """
        colours, label = self._named(values), f"{values}, mm" if values in _AXES else values
        if self.size:
            return plot_map(self.map_of(colours), label, axes)
        chosen = axes_or_new(axes)
        drawn = chosen.scatter(self.points[:, 0], self.points[:, 1], c=colours, s=0.5, linewidths=0)
        chosen.figure.colorbar(drawn, ax=chosen, label=label)
        chosen.set(xlabel="x, mm", ylabel="y, mm", aspect="equal")
        if not chosen.yaxis_inverted():
            chosen.invert_yaxis()
        return chosen

    def _named(self, name: str) -> NDArray[Any]:
        """Give the attribute (N,) of this name: `ConfigError` where there is none, `DataError` unknown."""
        if name in _AXES:
            return self.coordinates[:, _AXES.index(name)]
        if name not in _PLOTTED:
            raise ConfigError(f"values: '{name}' must be one of {', '.join((*_AXES, *_PLOTTED))}")
        values: NDArray[Any] | None = getattr(self, name)
        if values is None:
            available = [attribute for attribute in _PLOTTED if getattr(self, attribute) is not None]
            raise DataError(f"cloud: {name} is not known; known are {', '.join((*_AXES, *available))}")
        return values

    def to_trimesh(self) -> trimesh.Trimesh:
        """Convert to a mesh of trimesh: the surface over the pixel grid, cut at jumps in depth.

        Returns
        -------
        trimesh.Trimesh
            Corners are the points in mm, in their order; faces towards the camera.

        Raises
        ------
        DataError
            The pixels of the points are not known.
        """
        import trimesh

        return trimesh.Trimesh(self.coordinates, self.grid_mesh()[1], process=False)

    def to_open3d(self) -> Any:
        """Convert to a point cloud of Open3D.

        Returns
        -------
        open3d.geometry.PointCloud
            Points in mm, with normals and colours where they are known.

        Raises
        ------
        MissingExtraError
            Open3D is not installed.
        """
        need_extra("open3d")
        from open3d import geometry, utility

        cloud = geometry.PointCloud(utility.Vector3dVector(self.coordinates.astype(np.float64)))
        if self.normals is not None:
            cloud.normals = utility.Vector3dVector(self.normals.astype(np.float64))
        if self.colour is not None:
            cloud.colors = utility.Vector3dVector(self.colours() / 255.0)
        return cloud

    def to_xarray(self) -> Any:
        """Convert to a data set of xarray.

        Returns
        -------
        xarray.Dataset
            `x`, `y`, `z` and all that is known of each point: over the pixels `v`, `u` of the camera, NaN
            where there is no point; or over `point` where pixels are not known. Units are attributes.

        Raises
        ------
        MissingExtraError
            xarray is not installed.
        """
        need_extra("xarray")
        import xarray

        columns = {name: (self._named(name), "mm") for name in _AXES}
        if self.normals is not None:
            columns |= {name: (self.normals[:, i], "1") for i, name in enumerate(("nx", "ny", "nz"))}
        for name in _PLOTTED:
            if (values := getattr(self, name)) is not None:
                columns[name] = values, name.rpartition("_")[2] if "_" in name else "grey level"
        dims = ("v", "u") if self.size else ("point",)
        arranged = {
            name: (dims, self.map_of(values) if self.size else values, {"units": unit})
            for name, (values, unit) in columns.items()
        }
        return xarray.Dataset(arranged, attrs={"frame": "camera: x right, y down, z forward"})

    def colours(self) -> NDArray[np.uint8]:
        """Red, green and blue (N, 3) of the points: equal of a camera without colours, 0 where not known."""
        if self.rgb is not None:
            return self.rgb
        grey = np.zeros(len(self), np.uint8) if self.colour is None else self.colour
        return np.repeat(grey[:, None], 3, axis=1)

    @property
    def coordinates(self) -> Floats | CloudPoints:
        """The points in the frame of their file, (N, 3) in mm: of 64 bits where there is an origin."""
        return self.points.astype(np.float64) + self.origin_mm if any(self.origin_mm) else self.points

    @property
    def sigma_mm(self) -> CloudPoints | None:
        """Noise, phase error and calibration combined, float32 (N,) in mm: root mean square distance.

        None where noise or calibration is not known; a phase error that is not known is not in it.
        """
        along = self.sigma_along_ray_mm
        if along is None or self.sigma_calibration_mm is None:
            return None
        return _root_of_squares(along, self.sigma_calibration_mm)

    @property
    def sigma_along_ray_mm(self) -> CloudPoints | None:
        """Noise and phase error combined, float32 (N,) in mm along the camera's ray; None without noise."""
        if self.sigma_noise_mm is None or self.sigma_phase_error_mm is None:
            return self.sigma_noise_mm
        return _root_of_squares(self.sigma_noise_mm, self.sigma_phase_error_mm)

    def only(self, kept: Mask) -> Cloud:
        """Select points, with all their attributes.

        Parameters
        ----------
        kept : ndarray of bool
            (N,), True for the points of the result; at least one.

        Returns
        -------
        Cloud
            The selected points in the same order.

        Raises
        ------
        DataError
            The selection is of another number of points, or empty.
        """
        per_point = [f.name for f in fields(self) if f.name not in ("size", "origin_mm")]
        parts: dict[str, Any] = {name: getattr(self, name) for name in per_point}
        if kept.shape != (len(self),):
            raise DataError(f"cloud: a selection of {kept.shape} does not fit {len(self)} points")
        present = [name for name, part in parts.items() if part is not None]
        chosen: dict[str, Any] = dict(
            zip(present, select_rows([parts[name] for name in present], kept), strict=True)
        )
        return replace(self, **chosen)

    def grid(self) -> PixelGrid:
        """Arrange the points over the camera's pixels; raises `DataError` where these are not known."""
        if self.pixels is None or self.size is None:
            raise DataError("cloud: its points are not known by camera pixel; use a cloud that fpplab made")
        sigmas = (self.sigma_noise_mm, self.sigma_phase_error_mm) if self.sigma_noise_mm is not None else ()
        return PixelGrid.of(self.points, self.pixels, self.size, *(s for s in sigmas if s is not None))

    def grid_mesh(self) -> tuple[CloudPoints, NDArray[np.int32]]:
        """Mesh the surface over the pixel grid, cut at jumps in depth.

        `fpplab.clouds.pixelgrid` defines what counts as a jump.

        Returns
        -------
        vertices : ndarray of float32
            The points (N, 3) in mm.
        faces : ndarray of int32
            Indices (M, 3) of vertices; front sides face the camera.

        Raises
        ------
        DataError
            The pixels of the points are not known.
        """
        return self.points, self.grid().faces()


def _root_of_squares(a: CloudPoints, b: CloudPoints) -> CloudPoints:
    """As `np.hypot`, which takes ten times as long, to avoid overflows that no uncertainty comes near."""
    root = buffers.empty(len(a))
    _add_in_quadrature(a, b, root)
    return root


@kernel(parallel=True)
def _add_in_quadrature(a: CloudPoints, b: CloudPoints, root: CloudPoints) -> None:
    for i in prange(len(a)):
        root[i] = np.sqrt(a[i] * a[i] + b[i] * b[i])


def local_quadric_distance(cloud: Cloud, window: int = 15, max_points: int | None = None) -> CloudPoints:
    """Compute each point's distance from a quadric fitted to its pixel window."""
    # A measure of roughness where the true shape is not known. With a maximum of points, those of some rows;
    # NaN for the others.
    # returns (N,) mm
    if window < 5 or window % 2 == 0:
        raise ConfigError(f"window: {window} px must be an odd number, at least 5")
    step = 1 if max_points is None else max(1, -(-len(cloud) // max_points))
    return cloud.grid().quadric_distances(window, step)
