"""Prediction of a measurement on a simulation, from a sample of the camera's rows.

Bands of rows are simulated in place of whole frames: with the light of every pattern, computed once, and with
the sensor's noise drawn again for every draw. They are decoded, triangulated and compared like a measurement,
so that the prediction is that of a whole synthesis but for the sample.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.special import ndtri

from fpplab.calibration.model import Calibration, Uncertainty
from fpplab.clouds import Cloud
from fpplab.clouds.cloud import CloudPoints
from fpplab.comparison.alignment import LIMITS, AlignmentMesh, refine_pose
from fpplab.core import config
from fpplab.core.conventions import Floats, Image, Map, Mask, axis_length
from fpplab.core.depth import first_stated
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Rows
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.phase.bounds import DecodingBounds, PossibleCoordinates, PredictedCoordinate
from fpplab.phase.exposures import merged_recording
from fpplab.reconstruction.depth_range import decoding_bounds
from fpplab.reconstruction.points import points_of
from fpplab.reconstruction.triangulation import coordinate_noise
from sim.bench import VirtualBench
from sim.part_surface import PartSurface
from sim.prediction.discrepancy import Discrepancy
from sim.prediction.figures import SeenShape, figures_of, seen_surface
from sim.prediction.form import calibration_effects
from sim.prediction.intervals import (
    FigureInterval,
    PredictedLength,
    distance_sigma,
    figure_intervals,
    predicted_lengths,
)
from sim.sampling import ImagePartSampler
from sim.world import World
from sim.world.materials.base import surface_of

INNER = 8  # rows of a band that count (chosen)
MARGIN, FILTER_MARGIN = 2, 5
"""Rows at each end of a band that serve as neighbours alone; a plan's filter looks farther: it needs patches
of 25 pixels, which a band must not cut off."""
DRAWN_SCANS = 8  # that figures are the medians of (chosen)
ALIGNED_POINTS = 10_000  # of a scan (chosen: by noise of 50 µm it is then placed within 1 µm)


@dataclass(frozen=True)
class Prediction:
    """What a measurement will give."""

    item: str  # name of the item
    figures: dict[str, FigureInterval]  # by attribute of `MeasuredFigures`, `place_um` and `seconds`
    images: int  # number of images
    pixels: int  # number of pixels on the item that were simulated
    stripes: float  # of the finest patterns
    discrepancy: Discrepancy | None  # that the intervals contain; None for a rig that is no matched twin
    surface: PartSurface | None = None  # of the item as it was matched to a scan; None where it was not
    surface_known: bool = True  # whether it was matched, a part of its material compared, or it is the truth
    lengths: tuple[PredictedLength, ...] = ()  # of an artefact

    def summary(self) -> dict[str, Any]:
        discrepancy = self.discrepancy
        return {
            "item": self.item,
            **{name: figure.summary() for name, figure in self.figures.items()},
            "lengths": [length.summary() for length in self.lengths],
            "images": self.images,
            "pixels": self.pixels,
            "matched": discrepancy is not None,
            "surface": self.surface.summary() if self.surface else None,
            "surface_known": self.surface_known,
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
    sampler, source = rig.simulation.image_part_sampler(), Path(rig.source)
    # What is not known is the geometry of the twin's bench, as its own calibration says.
    known = replace(calibration or sampler.calibration, uncertainty=_uncertainty_beside(source.parent))
    mesh = sampler.mesh(item)
    visible, lit = seen_surface(mesh, known)
    if not lit.any():
        raise ConfigError(f"{rig.source}: no pixel sees lit surface of the item '{item}'")
    rows, inner = choose_sampled_rows(visible, pixels, FILTER_MARGIN if plan.filter else MARGIN)
    study = _Sampled(rig, plan, item, known, sampler, rows)
    # Noise, flicker and vibration are drawn anew; the last two are common to a whole frame.
    measured = [study.measured(seed) for seed in range(DRAWN_SCANS)]
    pose = aligned_pose(measured[0][1], mesh, visible)
    shape = SeenShape.of(mesh.copy().apply_transform(pose.matrix), known, inner)
    target = AlignmentMesh(shape.mesh)
    draws = [(decoded, _aligned(cloud, shape, target)) for decoded, cloud in measured]
    discrepancy = Discrepancy.beside(source)
    surface = sampler.surface(item)
    decoded, cloud = draws[0]
    noise = coordinate_noise(decoded)
    bounds, size = study.bounds, known.projector.size
    finest = max(each.finest_stripes(axis_length(size, each.coded_axis or "x")) for each in plan.sets)
    by_surface = noise_by_surface(rig.simulation.world, item, discrepancy)
    figures = figure_intervals(
        [figures_of(*draw, shape, plan, bounds, size) for draw in draws],
        calibration_effects(cloud, shape, known, noise, pose),
        discrepancy or Discrepancy(),
        by_surface,
        finest,
    )
    off_mm = 1e-3 * figures["distance_um"].value * distance_sigma(discrepancy or Discrepancy())
    lengths = predicted_lengths([cloud for _, cloud in draws], shape, known, noise, off_mm)
    seconds = plan_seconds(rig, plan)
    figures["seconds"] = FigureInterval(seconds, seconds, seconds)
    return Prediction(
        item=item,
        figures=figures,
        lengths=lengths,
        images=plan.frames,
        pixels=int(np.count_nonzero(shape.counted)),
        stripes=finest,
        discrepancy=discrepancy,
        surface=surface,
        surface_known=len(by_surface) == 1 or surface is not None,
    )


def _uncertainty_beside(folder: Path) -> Uncertainty | None:
    path = folder / "calibration.yaml"
    return Calibration.load(path).uncertainty if path.is_file() else None


def aligned_pose(cloud: Cloud, mesh: trimesh.Trimesh, visible: Mask) -> RigidTransform:
    """Find the motion that places a mesh, in the camera's frame, on the points of pixels that see it."""
    # The mesh is where the points are but for errors of the calibration, and no other pose is searched.
    assert cloud.pixels is not None
    u, v = cloud.pixels.T
    return _refined(cloud.points[visible[v, u]], AlignmentMesh(mesh)).inverse()


def _refined(points: CloudPoints, target: AlignmentMesh) -> RigidTransform:
    if not len(points):
        raise DataError("no point lies on the true shape: check the item's pose, light and exposure")
    few = points[:: max(1, len(points) // ALIGNED_POINTS)].astype(np.float64)
    return refine_pose(few, target, RigidTransform.identity(), LIMITS.fine_rounds)[0]


def _aligned(cloud: Cloud, shape: SeenShape, target: AlignmentMesh) -> Cloud:
    """Move a cloud onto the shape: vibration displaces each scan as a whole."""
    pose = _refined(cloud.points[shape.on_it(cloud)], target)
    return replace(cloud, points=pose.apply(cloud.points.astype(np.float64)).astype(np.float32))


def noise_by_surface(world: World, item: str, discrepancy: Discrepancy | None) -> Floats:
    """Equally likely factors of the noise, by what is not known of an item's surface."""
    # Noise is at most inversely proportional to the reflectance. Where no scan has shown the material of a
    # twin's part, any reflectance up to 1 is as likely; the world of no twin is itself the truth.
    material = world.material_of(item)
    surface, steps = surface_of(material), (np.arange(1_000) + 0.5) / 1_000
    if surface is not None:
        return np.asarray(np.exp(surface.relative_sigma * ndtri(steps)))
    parts = discrepancy.parts if discrepancy else (item,)
    if any(part in world.items and world.material_of(part) == material for part in parts):
        return np.ones(1)
    return float(config.plain(material)["reflectance"]) / steps


def plan_seconds(rig: Rig, plan: Plan) -> float:
    """Compute how long the images of a plan take, by what the devices state of themselves."""
    camera = rig.camera.caps
    other_s = camera.readout_s + camera.dark_s + plan.settle_s
    passes = zip(plan.passes, plan.exposures, strict=True)
    return sum(len(images) * (exposure_s + other_s) for images, exposure_s in passes)


def choose_sampled_rows(item_mask: Mask, pixels: int, margin: int = MARGIN) -> tuple[Rows, Rows]:
    """Choose bands of rows, evenly spread over what is seen of an item; all of them, and those that count."""
    # item_mask (height, width)
    used, band = np.flatnonzero(item_mask.any(axis=1)), np.arange(INNER + 2 * margin)
    first, end = max(0, int(used[0]) - margin), min(len(item_mask), int(used[-1]) + 1 + margin)
    share = min(1.0, pixels / max(1, int(np.count_nonzero(item_mask))))
    count = max(1, round(share * (end - first) / INNER))
    if count * len(band) >= end - first:
        every = np.arange(first, end)
        return every, every
    # In the middle of equal parts, so that the item's own edges count no more than they are.
    middles = first + (np.arange(count) + 0.5) * (end - first) / count
    starts = np.rint(middles - len(band) / 2).astype(np.intp)
    rows, inner = (np.unique(starts[:, None] + part) for part in (band, band[margin:-margin]))
    return rows, inner


@dataclass(eq=False)
class _Sampled:
    """A measurement of some rows, repeated with other noise."""

    rig: Rig
    plan: Plan
    item: str
    calibration: Calibration
    sampler: ImagePartSampler
    rows: Rows

    def __post_init__(self) -> None:
        caps = self.rig.projector.caps
        self.patterns = tuple(make_patterns(self.plan, caps.size, caps.lattice))
        depth = first_stated(
            (self.plan.depth_mm, "plan: 'depth_mm'"),
            (self.rig.file.depth_mm, f"{self.rig.source}: 'depth_mm'"),
        )
        self.bounds = decoding_bounds(self.plan, self.calibration, depth)

    def measured(self, seed: int) -> tuple[Decoded, Cloud]:
        several = [self.rig.camera_settings(each, self.plan.bits) for each in self.plan.exposures]
        frames = list[Image]()
        for k, (settings, images) in enumerate(zip(several, self.plan.passes, strict=True)):
            whole = len(images) == len(self.patterns)  # whose light is computed once
            shown = self.patterns if whole else tuple(self.patterns[i] for i in images)
            frames += self.sampler.frames(self.item, shown, settings, self.rows, seed + DRAWN_SCANS * k)
        projector, name = self.calibration.projector, f"the sample of the {self.item}"
        size, lattice = projector.size, projector.lattice
        recording = Recording(
            frames,
            self.plan,
            size,
            several[0].bits,
            name,
            lattice=lattice,
            bayer=self.rig.camera.caps.bayer,
            rows=self.rows,
        )
        recording = merged_recording(recording, self.plan.exposures)
        decoded = self._placed(decode(recording, bounds=self._bounds_of_rows()))
        return points_of(decoded, self.calibration, self.plan)

    def _frames(self, settings: CameraSettings, seed: int) -> Sequence[Image]:
        return self.sampler.frames(self.item, self.patterns, settings, self.rows, seed)

    def _bounds_of_rows(self) -> DecodingBounds:
        def of_rows(
            known: PossibleCoordinates | PredictedCoordinate,
        ) -> PossibleCoordinates | PredictedCoordinate:
            if isinstance(known, PredictedCoordinate):
                return PredictedCoordinate(lambda rows: cut(known.predict(self._whole(rows))))
            return PossibleCoordinates(cut(known.lower), cut(known.upper))

        def cut(values: Map) -> Map:
            return np.ascontiguousarray(values[self.rows])

        return {axis: of_rows(known) for axis, known in self.bounds.items()}

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
