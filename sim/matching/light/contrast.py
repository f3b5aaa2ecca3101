"""Contrast of fringes on parts, which shows how sharp projector and camera are where fringes are fine.

The board is recorded with fringes that can be unwrapped alone; on parts they are often several times finer,
and lose a large share of their contrast to a blur that the board's hardly show. Of a pixel that sees a matt
part the reflectance is not known, but offset A and amplitude B of its fringe are both proportional to it:
`B/A` is that of the light.

Light of the room adds to A alone. Its level is taken as found on the board, which faces the camera; on a
face that is turned away by its normal n, lamps of any number give more or less by a linear function of n
(Lambert's law), which is fitted to every scan and taken off. Where the twin's own lamp stands is not used:
on a flat board it makes up for gloss and falloff, and on turned faces its light would be taken for sharpness.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, PixelIndices, full_scale
from fpplab.core.geometry import RigidTransform
from fpplab.core.robust import huber_weights, robust_spread
from fpplab.devices import CameraSettings
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.plan import Plan
from fpplab.phase.common_errors import fit_sinusoids
from sim.matching.light.light_fit import level_slopes, light_residuals
from sim.matching.loss import board_mask, subsample_pixels
from sim.matching.reference import Reference
from sim.matching.samples import TILES, tile_numbers
from sim.matching.scene.artefacts import CLIPPED, SHORT, BenchScan, lit_inside, part_surface_seen
from sim.parameters import TwinParameters
from sim.twin import Twin


@dataclass(frozen=True)
class ContrastLimits:
    """How contrasts of fringes are compared."""

    rounds: int = 4  # robust fits of the light of the room on turned faces (chosen)
    pixels: int = 4_000  # of a scan that are compared, about (chosen, for speed)
    min_pixels: int = 200  # that determine a contrast (chosen)


LIMITS = ContrastLimits()


@dataclass(frozen=True, eq=False)
class ContrastSample:
    """Contrast of some fringe sets at some pixels that see a part."""

    number: int  # of the scan, from 0
    item: str  # the part, as the twin's world calls it
    T_camera_item: RigidTransform  # pose of the part, in mm
    settings: CameraSettings  # of the bench's camera
    sets: tuple[FringeSet, ...]  # the S sets that are compared
    patterns: tuple[Pattern, ...]  # of all their images, one set after the other
    pixels: PixelIndices  # rows and columns of the P pixels
    normals: Floats  # unit normals (P, 3) of what they see, in the camera's frame
    offset: Floats  # of the bench's fringes (S, P), in raw levels
    amplitude: Floats  # of the bench's fringes (S, P), in raw levels

    @cached_property
    def clusters(self) -> NDArray[np.int64]:
        """Numbers (3, S P) of row and column of the tile, and of the set, of every residual."""
        # What is left of a contrast reaches over a face of the part, and so over many tiles.
        tiles = TILES**2 * self.number + tile_numbers(self.pixels)
        row, column = (np.tile(index, len(self.sets)) for index in (tiles // TILES, tiles % TILES))
        sets = np.repeat(np.arange(len(self.sets)), len(tiles))
        return np.array([row, TILES * self.number + column, len(self.sets) * self.number + sets], np.int64)

    def residual(self, reference: Reference, twin: Twin) -> Floats:
        """Compare amplitudes with those that the twin has where it is as bright."""
        # returns (S P,)
        black = twin.parameters.black_level * full_scale(self.settings.bits)
        short = replace(self.settings, exposure_s=SHORT * self.settings.exposure_s)
        twin = twin.with_parameters(_with_even_room_light(twin.parameters))
        levels = twin.expected_part(self.item, self.T_camera_item, self.patterns, short, self.pixels)
        own = _fit_offsets_and_amplitudes(levels.astype(np.float64), self.sets)
        above, scale = np.maximum(own[0] - black, 1e-9), self._factors_of_equal_noise(reference)
        brightness = (self.offset - black) / above
        difference = np.nan_to_num(scale * (self.amplitude - brightness * own[1])).ravel()
        per_offset = scale * own[1] / above * np.isfinite(self.offset)
        turned = np.stack([(per_offset * slope).ravel() for slope in self.normals.T[:2]], axis=1)
        return _remove_explained(difference, turned)

    def relative_residual(self, reference: Reference, twin: Twin) -> Floats:
        """Compare contrasts by the tiles of the part."""
        level, tiles = self.level(reference), tile_numbers(self.pixels)
        lit = level > 0.0
        off = self.residual(reference, twin)[lit] / level[lit]
        cells = (np.arange(len(self.sets))[:, None] * TILES**2 + tiles).ravel()[lit]
        return np.array([np.median(off[cells == cell]) for cell in np.unique(cells)])

    def level(self, reference: Reference) -> Floats:
        # returns (S P,)
        return np.nan_to_num(self._factors_of_equal_noise(reference) * self.amplitude).ravel()

    def _factors_of_equal_noise(self, reference: Reference) -> Floats:
        """Factors (S, 1) that give amplitudes the noise of one image, in levels of the reference."""
        images = np.array([[fringe.images] for fringe in self.sets])
        return np.asarray(reference.full_scale / full_scale(self.settings.bits) * np.sqrt(0.5 * images))


def sample_contrasts(twin: Twin, scans: Sequence[BenchScan], board: Plan) -> list[ContrastSample]:
    """Sample the contrast of fringes on parts that are finer than all on the board."""
    fringes = (each.stripes for each in board.sets if isinstance(each, FringeSet))
    return list(_samples(twin, scans, max(fringes, default=0.0)))


def board_contrasts(reference: Reference, twin: Twin, poses: Sequence[int]) -> Floats:
    """Compare the contrast of the board's finest fringes with the twin's."""
    # returns (poses, axes that have fringes)
    plan, now = reference.plan, twin.parameters
    sets = {k: each for k in reference.finest_sets if isinstance(each := plan.sets[k], FringeSet)}
    black = now.black_level * reference.full_scale

    def contrast(levels: Floats, index: int) -> Floats:
        offset, cosine, sine = fit_sinusoids(levels, sets[index])
        return np.asarray(np.hypot(cosine, sine) / np.maximum(offset - black, 1.0))

    def of_pose(pose: int) -> list[float]:
        board = board_mask(now.calibration.camera, now.poses[pose], reference.target)
        pixels, ratios = subsample_pixels(board, LIMITS.pixels), []
        for index in sets:
            images = range(*plan.set_starts[index : index + 2])
            recorded = reference.frames(pose, images)[:, *pixels].astype(np.float64)
            shown = reference.shown(images)
            own = twin.expected_at(pose, shown, reference.settings, pixels).astype(np.float64)
            clear = np.maximum(recorded.max(axis=0), own.max(axis=0)) < CLIPPED * reference.full_scale
            ratio = contrast(recorded[:, clear], index) / contrast(own[:, clear], index)
            ratios.append(float(np.median(np.log(ratio))))
        return ratios

    return np.array([of_pose(pose) for pose in poses])


def with_common_error(
    reference: Reference, twin: Twin, names: Sequence[str], samples: Sequence[ContrastSample]
) -> TwinParameters:
    """Add to standard uncertainties that a whole scan's contrast may be off, as that of its tiles is."""
    # A fit of one scan takes for sharpness what all its pixels have in common, whatever it comes from.
    parameters = twin.parameters
    residuals = partial(light_residuals, reference, samples=samples)
    slopes = level_slopes(residuals, twin, names, residuals(twin))
    by_tile = np.concatenate([sample.relative_residual(reference, twin) for sample in samples])
    common = np.sqrt(np.mean(by_tile**2)) * np.concatenate([sample.level(reference) for sample in samples])
    scale = np.maximum(np.linalg.norm(slopes, axis=0), 1e-12)
    shift = np.linalg.lstsq(slopes / scale, common, rcond=1e-6)[0] / scale
    sigma = {
        name: float(np.hypot(parameters.sigma.get(name, 0.0), by))
        for name, by in zip(names, shift, strict=True)
    }
    return replace(parameters, sigma={**parameters.sigma, **sigma})


def _samples(twin: Twin, scans: Sequence[BenchScan], stripes: float) -> Iterator[ContrastSample]:
    for number, scan in enumerate(scans):
        plan, settings = scan.session.plan, scan.compared_pass.settings
        fringes = {k: each for k, each in enumerate(plan.sets) if isinstance(each, FringeSet)}
        finer = [index for index, fringe in fringes.items() if fringe.stripes > stripes]
        inner = lit_inside(twin, scan)
        if not finer or np.count_nonzero(inner) < LIMITS.min_pixels:
            continue
        pixels, sets = subsample_pixels(inner, LIMITS.pixels), tuple(fringes[index] for index in finer)
        images = [n for index in finer for n in range(*plan.set_starts[index : index + 2])]
        shown = make_patterns(plan, *scan.session.projector())
        levels = scan.levels(images, pixels)
        levels[:, levels.max(axis=0) >= CLIPPED * full_scale(settings.bits)] = np.nan
        if np.count_nonzero(np.isfinite(levels[0])) < LIMITS.min_pixels:
            continue
        yield ContrastSample(
            number,
            scan.item,
            scan.T_camera_item,
            settings,
            sets,
            tuple(shown[n] for n in images),
            pixels,
            part_surface_seen(twin, scan, pixels)[1],
            *_fit_offsets_and_amplitudes(levels, sets),
        )


def _with_even_room_light(parameters: TwinParameters) -> TwinParameters:
    """Give all surfaces the light that the room's lamp gives one which faces the camera."""
    facing = parameters.lamp_irradiance * max(np.cos(np.radians(parameters.lamp_angle_deg)), 0.0)
    return replace(parameters, ambient=parameters.ambient + facing, lamp_irradiance=0.0)


def _remove_explained(values: Floats, columns: Floats) -> Floats:
    """Take off what columns (N, C) explain of values (N,), whatever a few outliers say."""
    weight = np.ones_like(values)
    for _ in range(LIMITS.rounds):
        weighted = weight[:, None] * columns
        residual = values - columns @ (np.linalg.pinv(weighted.T @ columns) @ (weighted.T @ values))
        weight = huber_weights(residual, robust_spread(residual))
    return np.asarray(residual)


def _fit_offsets_and_amplitudes(levels: Floats, sets: Sequence[FringeSet]) -> tuple[Floats, Floats]:
    """Offsets and amplitudes (S, P) of sets whose images (n, P) follow one another."""
    ends = np.cumsum([0, *(fringe.images for fringe in sets)]).tolist()
    fits = [
        fit_sinusoids(levels[first:end], fringe)
        for fringe, (first, end) in zip(sets, pairwise(ends), strict=True)
    ]
    return np.stack([a for a, _, _ in fits]), np.stack([np.hypot(c, s) for _, c, s in fits])
