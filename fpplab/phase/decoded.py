"""What decoding gives: projector coordinates of every camera pixel, and their file."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fpplab.core.archives import load_arrays
from fpplab.core.conventions import Axis, Map, Mask
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.extras import need_extra
from fpplab.core.files import write_large
from fpplab.core.notebook import grey_picture, html_table, plot_map
from fpplab.phase.drift import PointingDrift
from fpplab.phase.edges import EdgeBlur
from fpplab.phase.limits import GUIDED_AXIS
from fpplab.phase.outside import OutsideShare

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class GuidedAxis:
    """How the fringes along an axis that the geometry guides agree with it."""

    share_off: float  # of pixels whose fringes lie more than a quarter of a period off
    phase_error_px: float  # 1-sigma of the coordinate by errors that all pixels of one phase share

    @property
    def is_contradicted(self) -> bool:
        """Whether most pixels lie off, so that nothing tells the orders and the coordinate is left out."""
        return self.share_off > GUIDED_AXIS.max_off_share


@dataclass(frozen=True, eq=False)
class Decoded:
    """What every camera pixel saw of the projector: maps [v, u], NaN where the pixel is not measured.

    Attributes
    ----------
    u, v : ndarray of float32, (height, width)
        Projector coordinates in px; all NaN (and then read-only) where the axis is not coded.
    modulation : ndarray of float32, (height, width)
        B of the finest set of the first coded axis (x before y), in 8-bit grey levels.
    sigma : ndarray of float32, (height, width)
        1-sigma of that axis' coordinate in projector px by the noise of all its sets that take part,
        independent from pixel to pixel.
    v_per_u : float
        How many times greater v's sigma is than u's where both are coded: from the plan, as if their
        modulations were equal, or where an axis is guided the median of all pixels.
    disagreement : ndarray of float32, (height, width), or None
        How much the fringe sets contradict one another, in units of what noise explains: the root of χ² of
        all sets about their weighted mean, per degree of freedom; 0 where nothing can contradict, None where
        it is not known.
    uncertain_order : ndarray of uint8, (height, width), or None
        1 + the index of the fringe set whose noise left the fringe order more uncertain than the plan allows
        (`MaskRules.wrong_order_max`), or whose bias has changed it, at a pixel that is not measured for that
        reason alone, 0 elsewhere; None where it is not known.
    removed : ndarray of uint8, (height, width), or None
        By which rule of the filter (`fpplab.reconstruction.filtering.Rule`) the pixel gives no point, 0 by
        none; None without a filter. The other maps keep what was decoded there.
    outside : OutsideShare or None
        How many pixels may see something outside of the possible positions; None where it is not known. It
        is not saved.
    sigma_phase_error : ndarray of float32, (height, width), or None
        1-sigma of the coordinate in projector px by errors of the phase that are common to all pixels of one
        phase, so that averaging does not lessen them: harmonics of the response, flicker of the lamp,
        rounding of the grey levels, and what the correction of edges may leave. None where neither the
        frames nor a measured response tell them.
    guided : GuidedAxis or None
        How the plan's guided axis agrees with the geometry; None where nothing guided it. It is not saved.
    drifts : mapping of str to PointingDrift
        By axis, how the projector's picture walked while the frames were taken, where they show it. It is
        not saved.
    edges : EdgeBlur or None
        The blur by which edges of reflectivity draw coordinates to their brighter side, and what it cost;
        None without such edges. It is not saved.
    island : ndarray of int32, (height, width), or None
        Where neighbours unwrapped the fringes: the number of the island that the pixel belongs to, negative
        where its fringe order is unknown, so that its coordinates are right up to a whole number of periods
        that all of the island shares; 0 where nothing is measured. None where the plan tells the orders.
    resolution_px : float or None
        Width of what one frame of fringes still shows, in camera px: its pixels share their neighbours'
        noise. None where every pixel is measured by itself. It is not saved.
    height_mm, sigma_height_mm : ndarray of float32, (height, width), or None
        Height over a reference plane with its 1-sigma, NaN where it is not measured or the fringe order is
        unknown; None without such a plane.
    """

    u: Map
    v: Map
    modulation: Map
    sigma: Map
    v_per_u: float = 1.0
    disagreement: Map | None = None
    removed: NDArray[np.uint8] | None = None
    uncertain_order: NDArray[np.uint8] | None = None
    outside: OutsideShare | None = None
    sigma_phase_error: Map | None = None
    guided: GuidedAxis | None = None
    drifts: Mapping[Axis, PointingDrift] = field(default_factory=dict)
    edges: EdgeBlur | None = None
    island: NDArray[np.int32] | None = None
    resolution_px: float | None = None
    height_mm: Map | None = None
    sigma_height_mm: Map | None = None

    def __repr__(self) -> str:
        height, width = self.sigma.shape
        share = 100.0 * self.valid.mean()
        return f"<Decoded: {width} x {height} px, {int(self.valid.sum())} measured ({share:.1f} %)>"

    def _repr_html_(self) -> str:
        some = self.sigma[self.valid]
        axis: Axis = "x" if np.isfinite(self.u).any() else "y"
        rows: dict[str, object] = {
            "camera": f"{self.sigma.shape[1]} x {self.sigma.shape[0]} px",
            "measured": f"{some.size:,} pixels ({100.0 * self.valid.mean():.1f} %)",
            "sigma": f"median {float(np.median(some)):.4f} px" if some.size else None,
            "modulation": f"median {float(np.median(self.modulation[self.valid])):.1f}"
            if some.size
            else None,
        }
        return html_table("Decoded", rows, grey_picture(np.where(self.valid, self.coordinate(axis), np.nan)))

    def plot(self, values: str = "u", axes: Axes | None = None) -> Axes:
        """Draw one of the maps.

        Parameters
        ----------
        values : str
            Which: "u", "v", "modulation", "sigma", "sigma_total" or another map that is known.
        axes : matplotlib.axes.Axes, optional
            Where to draw; new ones by default.

        Returns
        -------
        matplotlib.axes.Axes
            With the map.

        Raises
        ------
        ConfigError
            There is no such map, or it is not known.
        """
        maps = {**self._maps(), "sigma_total": self.sigma_total}
        if values not in maps:
            raise ConfigError(f"values: '{values}' must be one of {', '.join(maps)}")
        unit = {"modulation": "grey levels", "disagreement": "in units of noise"}.get(values, "px")
        return plot_map(maps[values], f"{values}, {unit}", axes)

    def to_xarray(self) -> Any:
        """Convert to a data set of xarray.

        Returns
        -------
        xarray.Dataset
            The maps that are known, over the camera's pixels `v`, `u`; the projector's coordinates are
            called `projector_u` and `projector_v`.

        Raises
        ------
        MissingExtraError
            xarray is not installed.
        """
        need_extra("xarray")
        import xarray

        named = {"u": "projector_u", "v": "projector_v"}
        maps = {named.get(name, name): (("v", "u"), values) for name, values in self._maps().items()}
        return xarray.Dataset(maps)

    def _maps(self) -> dict[str, Map]:
        """The maps of values that are known, by name."""
        names = ("u", "v", "modulation", "sigma", "disagreement", "sigma_phase_error")
        return {name: values for name in names if (values := getattr(self, name)) is not None}

    @property
    def sigma_total(self) -> Map:
        """1-sigma of the coordinate in projector px by noise and, where they are known, common errors."""
        return self.sigma if self.sigma_phase_error is None else np.hypot(self.sigma, self.sigma_phase_error)

    @property
    def typical_disagreement(self) -> float:
        """Median of `disagreement` at pixels spread over the image; NaN where it is known at none."""
        if self.disagreement is None:
            return np.nan
        some = self.disagreement[::4, ::4]  # a sixteenth of the pixels tells the median well enough
        finite = some[np.isfinite(some)]
        return float(np.median(finite)) if finite.size else np.nan

    def coordinate(self, axis: Axis) -> Map:
        """Give the projector coordinate along one axis.

        Parameters
        ----------
        axis : str
            x or y.

        Returns
        -------
        ndarray of float32, (height, width)
            `u` or `v`, in px.
        """
        return self.u if axis == "x" else self.v

    @property
    def maps(self) -> tuple[Map | None, ...]:
        """All maps of what was decoded."""
        return self.u, self.v, self.modulation, self.sigma, self.sigma_phase_error, self.disagreement

    @property
    def valid(self) -> Mask:
        """Where the pixel is measured."""
        return np.isfinite(self.sigma)

    def of_known_order(self) -> Decoded:
        """Leave out the islands whose fringe order is unknown, but for their numbers in `island`."""
        if self.island is None or not (self.island < 0).any():
            return self
        unknown, nan = self.island < 0, np.float32(np.nan)
        names = ("u", "v", "modulation", "sigma", "sigma_phase_error", "disagreement")
        maps = {name: getattr(self, name) for name in names}
        kept: dict[str, Any] = {k: None if m is None else np.where(unknown, nan, m) for k, m in maps.items()}
        return replace(self, **kept)

    def save(self, path: Path | str) -> None:
        """Write an NPZ file with the keys u, v, modulation, sigma, whole or not at all.

        Parameters
        ----------
        path : path or str
            The file; replaced if it exists.

        Raises
        ------
        DataError
            It cannot be written.
        """
        maps = {name: getattr(self, name) for name in (*_KEYS, *_OPTIONAL)}
        maps = {name: values for name, values in maps.items() if values is not None}
        arrays = {**maps, "v_per_u": np.asarray(self.v_per_u)}
        write_large(Path(path), lambda stream: _write_npz(arrays, stream))

    @classmethod
    def load(cls, path: Path | str) -> Decoded:
        """Read what `save` wrote.

        Parameters
        ----------
        path : path or str
            The file.

        Returns
        -------
        Decoded
            The maps.

        Raises
        ------
        DataError
            The file is missing, damaged or of another kind.
        """
        try:
            arrays = load_arrays(Path(path), (*_KEYS, "v_per_u", *_OPTIONAL))
            maps: dict[str, Any] = {name: arrays[name] for name in _KEYS}
            v_per_u = float(arrays["v_per_u"])
            optional: dict[str, Any] = {name: arrays[name] for name in _OPTIONAL if name in arrays}
        except FileNotFoundError:
            raise DataError(f"{path}: there is no such file; decode a session into it first") from None
        except KeyError as error:
            raise DataError(f"{path}: is no decoded measurement, it has no '{error.args[0]}'") from error
        except (OSError, ValueError, TypeError) as error:
            raise DataError(
                f"{path}: is damaged or no NPZ file ({error}); decode the session again"
            ) from error
        kinds = {(m.shape, m.dtype.name, m.ndim) for m in maps.values()}
        if len(kinds) != 1 or next(iter(kinds))[1:] != ("float32", 2):
            raise DataError(f"{path}: its maps must be float32 images of one size; decode the session again")
        for name, values in optional.items():
            if values.shape != maps["u"].shape:
                raise DataError(
                    f"{path}: '{name}' is of another size than the maps; decode the session again"
                )
        return cls(**maps, v_per_u=v_per_u, **optional)


_KEYS = "u", "v", "modulation", "sigma"
_OPTIONAL = (
    "disagreement",
    "uncertain_order",
    "removed",
    "sigma_phase_error",
    "island",
    "height_mm",
    "sigma_height_mm",
)


def _write_npz(arrays: Mapping[str, NDArray[Any]], stream: BinaryIO) -> None:
    """As `np.savez`, which copies everything once more."""
    with zipfile.ZipFile(stream, "w") as archive:
        for name, values in arrays.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                header = np.lib.format.header_data_from_array_1_0(values)  # type: ignore[no-untyped-call]
                header["fortran_order"] = False
                np.lib.format.write_array_header_1_0(member, header)  # type: ignore[no-untyped-call]
                # In parts of 1 MB, because a map of an axis that is not coded is one value, seen as many.
                for part in np.array_split(np.atleast_1d(values), max(1, values.nbytes >> 20)):
                    member.write(np.ascontiguousarray(part).reshape(-1).view(np.uint8).data)
