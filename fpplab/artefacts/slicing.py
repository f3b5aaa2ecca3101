"""The shape of a part as a 3D printer makes it: layers of molten filament, stacked along z from z = 0."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np
from manifold3d import CrossSection, Error, JoinType, Manifold, OpType

from fpplab.artefacts.parts import check_solid
from fpplab.artefacts.solids import to_manifold, to_trimesh
from fpplab.core.conventions import Floats
from fpplab.core.errors import ConfigError

if TYPE_CHECKING:
    import trimesh


@dataclass(frozen=True)
class SlicingLimits:
    """Limits of slicing a solid into layers."""

    max_layers: int = 2000  # number of layers (chosen)
    bead_levels: int = 3  # depths of a bead's round profile (derived: accurate to a quarter of the grooves)
    negligible_mm: float = 1e-5  # counts as 0 (chosen above the rounding of 32 bit floats)
    max_base_offset_mm: float = 1e-3  # distance of a part's lowest point from z = 0 (chosen)


LIMITS = SlicingLimits()


def slice_as_printed(mesh: trimesh.Trimesh, layer_mm: float, bead_mm: float = 0.0) -> trimesh.Trimesh:
    """Compute the shape that a 3D printer makes of a part."""
    # Layer k lies between `k * layer_mm` and `(k + 1) * layer_mm`, and is the part's cross-section at
    # mid-height of the layer. The printed height is the part's, rounded to whole layers (`layer_count`).
    check_solid(mesh, "the part")
    low, high = mesh.bounds[:, 2]
    if abs(low) > LIMITS.max_base_offset_mm:
        raise ConfigError(f"the part: stands on z = {low:g} mm; move it so that it stands on 0")
    layers = layer_count(high, layer_mm)
    if not 0 <= bead_mm < layer_mm / 2:
        raise ConfigError(
            f"bead_mm: {bead_mm:g} mm must be from 0 to less than half a layer, {layer_mm / 2:g} mm"
        )
    solid = _solid(mesh)
    depths, edges = _profile(layer_mm, bead_mm)
    bottoms = np.arange(layers) * layer_mm
    middles = bottoms + layer_mm / 2
    outlines = [outline for z in middles for outline in _bead(solid, z, depths)]
    heights = np.append(0.0, np.add.outer(bottoms, edges[1:]))
    return _mesh(_stack(outlines), heights)


def layer_count(height_mm: float, layer_mm: float) -> int:
    """Count a printed part's layers, those whose middle lies in it: half a layer rounds down."""
    if not (layer_mm > 0 and np.isfinite(layer_mm)):
        raise ConfigError(f"layer_mm: {layer_mm:g} mm must be above 0 mm")
    layers = np.ceil((height_mm - LIMITS.negligible_mm) / layer_mm - 0.5)
    if layers < 1:
        raise ConfigError(
            f"layer_mm: {layer_mm:g} mm must be less than twice the part's height, {height_mm:g} mm"
        )
    if layers > LIMITS.max_layers:
        raise ConfigError(
            f"layer_mm: {layer_mm:g} mm makes more than {LIMITS.max_layers} layers of {height_mm:g} mm; "
            f"give at least {height_mm / LIMITS.max_layers:g} mm"
        )
    return int(layers)


def _solid(mesh: trimesh.Trimesh) -> Manifold:
    solid = to_manifold(mesh)
    if solid.status() != Error.NoError:
        raise ConfigError(f"the part: is no solid ({solid.status().name}); repair it in a mesh editor")
    return solid


def _profile(layer_mm: float, bead_mm: float) -> tuple[Floats, Floats]:
    """Compute depths (L,) from a layer's middle to its edge, and the heights (2L,) that separate them."""
    # The arc through depth 0 in the middle and `bead_mm` at the edges, rounded to the nearest depth.
    if bead_mm == 0:
        return np.zeros(1), np.array([0.0, layer_mm])
    half = layer_mm / 2
    radius = (half**2 + bead_mm**2) / (2 * bead_mm)
    depths = np.linspace(0.0, bead_mm, LIMITS.bead_levels)
    between = (depths[:-1] + depths[1:]) / 2
    away = np.sqrt(between * (2 * radius - between))
    return depths, np.concatenate([[0.0], half - away[::-1], half + away, [layer_mm]])


def _bead(solid: Manifold, z: float, depths: Floats) -> list[CrossSection]:
    """Compute the outlines (2L - 1) of one layer, from its lower edge to its upper one."""
    # What ends exactly at mid-height of a layer is not part of that layer, as in `layer_count`.
    widest = solid.slice(z + LIMITS.negligible_mm).simplify(LIMITS.negligible_mm)
    inner = [widest.offset(-depth, JoinType.Miter) for depth in depths[1:]]
    if any(outline.num_contour() != widest.num_contour() for outline in inner):
        raise ConfigError(
            f"bead_mm: {depths[-1]:g} mm is half of a feature's width or more at z = {z:g} mm; give less"
        )
    return [*inner[::-1], widest, *inner]


def _stack(outlines: list[CrossSection]) -> Manifold:
    body = Manifold.batch_boolean(list(_slabs(outlines)), OpType.Add)
    shells = [shell.volume() for shell in body.decompose()]
    bodies = sum(volume > 0 for volume in shells)  # the shell of a cavity has a negative volume
    if bodies != 1:
        raise ConfigError(
            f"the part: its layers make {bodies} separate bodies; give one body, or thinner layers"
        )
    return body


def _slabs(outlines: list[CrossSection]) -> Iterator[Manifold]:
    start = 0
    # Equal neighbours as one, so that plain walls get no extra edges.
    for _, run in groupby(outlines, key=lambda outline: [part.tobytes() for part in outline.to_polygons()]):
        same = list(run)
        yield same[0].extrude(len(same)).translate((0.0, 0.0, start))
        start += len(same)


def _mesh(body: Manifold, heights: Floats) -> trimesh.Trimesh:
    mesh = to_trimesh(body)
    mesh.vertices[:, 2] = heights[np.rint(mesh.vertices[:, 2]).astype(int)]
    return mesh
