"""Heights of a session over a reference plane: two recordings of one plan, and how the devices stand."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fpplab.core.config import load_document, resolve_relative_to
from fpplab.core.conventions import Axis, Floats, Map, axis_length
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.progress import Progress, no_progress
from fpplab.patterns.fringe_sets import PeriodicSet
from fpplab.patterns.recording import KnownCoordinate, Recording
from fpplab.patterns.unwrapping import unwrapping_methods
from fpplab.phase import Decoded, decode
from fpplab.phase.bounds import PossibleCoordinates
from fpplab.phase.limits import PLANE
from fpplab.phase.reference_plane import HeightModel, PlaneGeometry, fit_plates
from fpplab.pipeline.decoding import recording_and_fault, spatial_axes
from fpplab.reconstruction.depth_range import KnownPixels
from fpplab.sessions.session import Session


@dataclass(frozen=True, eq=False)
class ReferencePlane:
    """The coordinate of every pixel on the plane, and what heights make of it."""

    name: str  # of the session
    recording: Recording
    axis: Axis
    coordinate: Map  # px, of one island where neighbours unwrapped it, NaN elsewhere
    sigma: Map  # px
    model: HeightModel
    heights_mm: tuple[float, float] | None  # between which everything lies

    @property
    def period_px(self) -> float:
        """Period of the finest fringes along the axis, in projector px."""
        sets = [s for s in self.recording.plan.sets if isinstance(s, PeriodicSet) and s.axis == self.axis]
        return axis_length(self.recording.projector_size, self.axis) / max(s.stripes for s in sets)

    def decode(
        self, recording: Recording, heights_mm: tuple[float, float] | None, progress: Progress = no_progress
    ) -> Decoded:
        """Decode a recording of the same plan, in which heights tell the orders that neighbours do not."""
        if recording.plan.sets != self.recording.plan.sets:
            raise ConfigError(
                f"{recording.name}: its plan has other sets than {self.name}; record both by one"
            )
        if recording.frames[0].shape != self.coordinate.shape:
            raise DataError(f"{recording.name}: its frames have another size than those of {self.name}")
        if not unwrapping_methods()[recording.plan.unwrapping].spatial or heights_mm is None:
            return decode(recording, progress)
        ends = [self.coordinate + self.model.displacement(height) for height in heights_mm]
        last = np.float32(axis_length(recording.projector_size, self.axis) - 0.5)
        lower = np.nan_to_num(np.minimum(*ends), nan=-0.5).astype(np.float32)
        upper = np.nan_to_num(np.maximum(*ends), nan=float(last)).astype(np.float32)
        return decode(recording, progress, {self.axis: PossibleCoordinates(lower, upper)})

    def displacement(self, decoded: Decoded) -> tuple[Floats, Floats]:
        """Give by how much the coordinate differs from the plane's where its order is known, with sigma."""
        placed = decoded.of_known_order()
        moved = placed.coordinate(self.axis) - self.coordinate
        return np.asarray(moved, np.float64), np.hypot(placed.sigma_total, self.sigma)


def plane_of(
    recording: Recording, geometry: PlaneGeometry, plates: Sequence[tuple[float, Recording]]
) -> ReferencePlane:
    """Decode the plane, and plates by their heights in mm if there are any."""
    axis = recording.plan.unwrapped_axes[0]
    decoded = decode(recording)
    coordinate = decoded.coordinate(axis)
    if decoded.island is not None:
        labels = np.abs(decoded.island)
        largest = np.argmax(np.bincount(labels.ravel(), minlength=2)[1:]) + 1
        coordinate = np.where(labels == largest, coordinate, np.float32(np.nan))
    flat = HeightModel(0.0, 1.0)
    plane = ReferencePlane(
        recording.name, recording, axis, coordinate, decoded.sigma_total, flat, geometry.heights_mm
    )
    plane = replace(plane, model=geometry.model(plane.period_px))
    if not plates:
        return plane
    moved = []
    for height_mm, frames in plates:
        px_per_mm = abs(float(plane.model.displacement(height_mm)) / height_mm)
        half_mm = PLANE.known_turns * plane.period_px / px_per_mm
        moved.append(plane.displacement(plane.decode(frames, (height_mm - half_mm, height_mm + half_mm))))
    displacements, sigmas = zip(*moved, strict=True)
    return replace(plane, model=fit_plates([height_mm for height_mm, _ in plates], displacements, sigmas))


def decode_over_plane(
    recording: Recording,
    reference: Path,
    file: Path,
    known_mm: KnownPixels = (),
    progress: Progress = no_progress,
) -> Decoded:
    """Decode a recording, with heights over the plane of a session of the same plan."""
    geometry = load_document(file, PlaneGeometry)

    def frames_of(folder: Path | str) -> Recording:
        return recording_and_fault(Session.open(folder), no_progress, as_recorded=False)[0]

    plates = [
        (plate.height_mm, frames_of(resolve_relative_to(plate.session, file.parent)))
        for plate in geometry.plates
    ]
    return decode_heights(recording, plane_of(frames_of(reference), geometry, plates), known_mm, progress)


def decode_heights(
    recording: Recording,
    plane: ReferencePlane,
    known_mm: KnownPixels = (),
    progress: Progress = no_progress,
) -> Decoded:
    if known_mm:
        spatial_axes(recording)
    points = []
    for column, row, height_mm in known_mm:
        moved = plane.model.displacement(height_mm)
        rows, columns = plane.coordinate.shape
        at = plane.coordinate[row, column] if 0 <= row < rows and 0 <= column < columns else np.nan
        value = float(at + (moved[row, column] if moved.ndim else moved))
        if not np.isfinite(value):
            raise ConfigError(f"--known: pixel {column}, {row} is not measured on {plane.name}")
        points.append(KnownCoordinate((column, row), value))
    decoded = plane.decode(replace(recording, known=tuple(points)), plane.heights_mm, progress)
    height, sigma = plane.model.heights(*plane.displacement(decoded))
    return replace(decoded, height_mm=height.astype(np.float32), sigma_height_mm=sigma.astype(np.float32))
