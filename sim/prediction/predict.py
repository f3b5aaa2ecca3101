"""Prediction of a measurement on a simulation, from a sample of the camera's rows.

Bands of rows are simulated in place of whole frames: with the light of every pattern, computed once, and with
the sensor's noise drawn again for every draw. They are decoded, triangulated and compared like a measurement,
so that the prediction is that of a whole synthesis but for the sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.conventions import Map, Mask
from fpplab.core.depth import first_stated
from fpplab.core.errors import ConfigError
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Rows
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.phase.bounds import DecodingBounds, PossibleCoordinates, PredictedCoordinate
from fpplab.reconstruction.depth_range import decoding_bounds
from fpplab.reconstruction.points import points_of
from fpplab.reconstruction.triangulation import coordinate_noise
from sim.bench import VirtualBench
from sim.part_surface import PartSurface
from sim.prediction.discrepancy import Discrepancy
from sim.prediction.figures import MeasuredFigures, figures_of, seen_surface
from sim.prediction.form import distance_factors
from sim.prediction.intervals import FigureInterval, figure_intervals
from sim.sampling import ImagePartSampler

BAND, MARGIN = 12, 2  # rows of a band, and how many at each of its ends serve as neighbours alone


@dataclass(frozen=True)
class Prediction:
    """What a measurement will give."""

    item: str  # name of the item
    figures: dict[str, FigureInterval]  # by attribute of `MeasuredFigures`, and `seconds`
    images: int  # number of images
    pixels: int  # number of pixels on the item that were simulated
    stripes: float  # of the finest fringes
    discrepancy: Discrepancy | None  # that the intervals contain; None for a rig that is no matched twin
    surface: PartSurface | None = None  # of the item as it was matched to a scan; None where it was not

    def summary(self) -> dict[str, Any]:
        """Give plain values, as the command line prints them."""
        discrepancy = self.discrepancy
        return {
            "item": self.item,
            **{name: figure.summary() for name, figure in self.figures.items()},
            "images": self.images,
            "pixels": self.pixels,
            "matched": discrepancy is not None,
            "surface": self.surface.summary() if self.surface else None,
            "looks_like": discrepancy.looks_like if discrepancy else None,
            "not_for": discrepancy.not_for if discrepancy else None,
            "compared_stripes": self._compared_stripes,
        }

    @property
    def _compared_stripes(self) -> float | None:
        compared = self.discrepancy.contrast if self.discrepancy else None
        return compared.stripes if compared and self.stripes > compared.stripes else None


def predict(
    rig: Rig, plan: Plan, item: str, calibration: Calibration | None = None, pixels: int = 40_000
) -> Prediction:
    """Predict a measurement of an item on an open rig of a simulation, by about `pixels` of its pixels."""
    if not isinstance(rig.simulation, VirtualBench):
        raise ConfigError(f"{rig.source}: is no simulation that can predict; name a twin's rig file")
    sampler, folder = rig.simulation.image_part_sampler(), Path(rig.source).parent
    used_calibration = calibration or _with_uncertainty_beside(sampler.calibration, folder)
    mesh = sampler.mesh(item)
    seen, lit = seen_surface(mesh, used_calibration)
    if not lit.any():
        raise ConfigError(f"{rig.source}: no pixel sees lit surface of the item '{item}'")
    rows, inner = choose_sampled_rows(seen, pixels)
    counted = np.zeros_like(seen)
    counted[inner] = True
    study = _Sampled(rig, plan, item, used_calibration, sampler, mesh, rows, (seen & counted, lit & counted))
    # Noise, flicker and vibration are drawn anew; the last two are common to a whole frame.
    draws = [study.measured(seed) for seed in range(8)]
    _, decoded, cloud = draws[0]
    discrepancy = Discrepancy.beside(Path(rig.source))
    surface = sampler.surface(item)
    figures = figure_intervals(
        [measured for measured, _, _ in draws],
        distance_factors(cloud, seen & counted, mesh, used_calibration, coordinate_noise(decoded)),
        discrepancy or Discrepancy(),
        surface.relative_sigma if surface else 0.0,
        plan.most_stripes,
    )
    seconds = plan_seconds(rig, plan)
    figures["seconds"] = FigureInterval(seconds, seconds, seconds)
    sampled = int(np.count_nonzero(seen & counted))
    return Prediction(item, figures, len(study.patterns), sampled, plan.most_stripes, discrepancy, surface)


def _with_uncertainty_beside(true: Calibration, folder: Path) -> Calibration:
    path = folder / "calibration.yaml"
    return replace(true, uncertainty=Calibration.load(path).uncertainty) if path.is_file() else true


def plan_seconds(rig: Rig, plan: Plan) -> float:
    """Compute how long the images of a plan take, by what the devices state of themselves."""
    camera = rig.camera.caps
    images = sum(fringe.images for fringe in plan.fringes)
    return images * (plan.exposure_s + camera.readout_s + camera.dark_s + plan.settle_s)


def choose_sampled_rows(item_mask: Mask, pixels: int) -> tuple[Rows, Rows]:
    """Choose bands of rows, evenly spread over what is seen of an item."""
    # item_mask (height, width)
    used = np.flatnonzero(item_mask.any(axis=1))
    first, end = max(0, int(used[0]) - MARGIN), min(len(item_mask), int(used[-1]) + 1 + MARGIN)
    share = min(1.0, pixels / max(1, int(np.count_nonzero(item_mask))))
    inside = BAND - 2 * MARGIN
    count = max(1, round(share * (end - first) / inside))
    if count * BAND >= end - first:
        every = np.arange(first, end)
        return every, every
    starts = np.rint(np.linspace(first, end - BAND, count)).astype(np.intp)
    band = np.arange(BAND)
    rows, inner = (np.unique(starts[:, None] + part) for part in (band, band[MARGIN:-MARGIN]))
    return rows, inner


@dataclass(eq=False)
class _Sampled:
    """A measurement of some rows, repeated with other noise."""

    rig: Rig
    plan: Plan
    item: str
    calibration: Calibration
    sampler: ImagePartSampler
    mesh: trimesh.Trimesh
    rows: Rows
    surface: tuple[Mask, Mask]  # pixels that see the item, and those where it is lit as well

    def __post_init__(self) -> None:
        caps = self.rig.projector.caps
        self.patterns = tuple(make_patterns(self.plan, caps.size, caps.lattice))
        depth = first_stated(
            (self.plan.depth_mm, "plan: 'depth_mm'"),
            (self.rig.file.depth_mm, f"{self.rig.source}: 'depth_mm'"),
        )
        self._bounds = decoding_bounds(self.plan, self.calibration, depth)

    def measured(self, seed: int) -> tuple[MeasuredFigures, Decoded, Cloud]:
        settings = self.rig.camera_settings(self.plan.exposure_s, self.plan.bits)
        frames = self.sampler.frames(self.item, self.patterns, settings, self.rows, seed)
        size, name = self.calibration.projector.size, f"the sample of the {self.item}"
        of_rows = self._bounds_of_rows()
        recording = Recording(frames, self.plan, size, settings.bits, name)
        decoded = self._placed(decode(recording, bounds=of_rows))
        decoded, cloud = points_of(decoded, self.calibration, self.plan)
        figures = figures_of(
            decoded, cloud, self.mesh, self.calibration, self.plan, self.surface, self._bounds
        )
        return figures, decoded, cloud

    def _bounds_of_rows(self) -> DecodingBounds:
        def of_rows(
            known: PossibleCoordinates | PredictedCoordinate,
        ) -> PossibleCoordinates | PredictedCoordinate:
            if isinstance(known, PredictedCoordinate):
                return PredictedCoordinate(lambda rows: cut(known.predict(self._whole(rows))))
            return PossibleCoordinates(cut(known.lower), cut(known.upper))

        def cut(values: Map) -> Map:
            return np.ascontiguousarray(values[self.rows])

        return {axis: of_rows(known) for axis, known in self._bounds.items()}

    def _whole(self, values: Any) -> Any:
        """Put a map of the rows where they are in the image; NaN, or 0 in flags, elsewhere."""
        if values is None:
            return None
        width, height = self.calibration.camera.size
        empty = np.nan if np.issubdtype(values.dtype, np.floating) else 0
        whole = np.full((height, width), empty, values.dtype)
        whole[self.rows] = values
        return whole

    def _placed(self, decoded: Decoded) -> Decoded:
        names = ("u", "v", "modulation", "sigma", "disagreement", "uncertain_order", "sigma_phase_error")
        return replace(
            decoded,
            outside=None,
            removed=None,
            **{name: self._whole(getattr(decoded, name)) for name in names},
        )
