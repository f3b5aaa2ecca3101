"""The sheet of a board, found from its recordings: blank margins, a dark frame, and the texture of its print.

In every pose the levels of bench and twin are compared pixel by pixel, least squares over all images. Where
the twin shows the same sheet their ratio is the factor by which the bench's reflects more; mapped onto the
sheet, its median over the poses is what belongs to the board and not to the light. Beyond the target the
twin's sheet is blank: as far as the bench's levels follow the same fringes and are about as bright, it is
sheet there as well, and a frame where they are dark.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats, Mask
from fpplab.core.geometry import RigidTransform
from sim.appearance import NO_MARGINS, Appearance, BoardSheet
from sim.matching.reference import LevelStack, Reference
from sim.twin import Twin

Margins = tuple[float, float, float, float]  # on the left, top, right and bottom, in mm
_Strip = tuple[Floats, LevelStack]
"""Distances in mm beyond a side of the sheet, and the values of the pixels that are so far away."""


@dataclass(frozen=True)
class SheetLimits:
    """How the sheet of a board is found."""

    reach: float = 0.3  # share of the target's smaller side beyond it that is searched (chosen)
    ring_mm: float = 0.5  # width of the rings in which pixels are counted (chosen)
    min_ring_pixels: int = 50  # that are seen lit of a ring (chosen)
    min_correlation: float = 0.97  # of levels that follow the same fringes (chosen)
    min_blank_share: float = 0.5  # of the light of a blank sheet, for a pixel of the sheet (chosen)
    max_dark_share: float = 0.2  # of the sheet's light, for a pixel of the frame (chosen)
    blurred_mm: float = 1.0  # along the sheet's edge, where a frame is not yet dark (chosen)
    min_lit_level: float = 0.04  # mean level as a share of full scale (chosen)
    texture_px: float = 1.0  # pixels of the camera for one of the texture, at the nearest pose (chosen)
    sharpening_rounds: int = 2  # corrections of the texture; more make its noise greater (chosen)
    max_factor: float = 1.9  # of a texture: what its file can hold (derived)


LIMITS = SheetLimits()


@dataclass(frozen=True, eq=False)
class _Compared:
    """One pose: how much brighter the bench is than the twin's sheet, and whether by the same fringes."""

    ratio: LevelStack  # (height, width), NaN where the twin's sheet is not lit
    correlation: LevelStack  # (height, width), NaN where the twin's sheet is not lit
    pose: RigidTransform  # `T_camera_board`

    @property
    def as_sheet(self) -> LevelStack:
        """The ratio where levels follow the same fringes, 0 where they do not."""
        return self.ratio * (self.correlation > LIMITS.min_correlation)


def find_sheet(reference: Reference, twin: Twin, poses: Sequence[int]) -> BoardSheet:
    reach = LIMITS.reach * min(reference.target.size_mm)
    wide = twin.with_appearance(Appearance(BoardSheet((reach, reach, reach, reach))))
    compared = [_compare_images(reference, wide, pose) for pose in poses]
    margins = _sheet_margins(reference, twin, compared, reach)
    beyond = [
        [_beyond_side(reference, twin, pose, pose.ratio, margins, k) for k in range(4)] for pose in compared
    ]
    rim = _rim_mm(beyond, reach)
    sheet = BoardSheet(margins, rim, _rim_reflectance(beyond, rim, twin.parameters.paper))
    return replace(sheet, texture=_sheet_texture(reference, twin, compared, margins))


def sharpened_sheet(reference: Reference, twin: Twin, sheet: BoardSheet, poses: Sequence[int]) -> BoardSheet:
    """Find the texture again, beyond what the twin shows of it already."""
    # A texture that was found in images has been blurred by a lens, and the twin's lens blurs it once more.
    assert sheet.texture is not None
    for _ in range(LIMITS.sharpening_rounds):
        so_far = twin.with_appearance(Appearance(sheet))
        compared = [_compare_images(reference, so_far, pose) for pose in poses]
        texture = sheet.texture * _sheet_texture(reference, twin, compared, sheet.margins_mm)
        sheet = replace(sheet, texture=np.clip(texture, 0, np.float32(LIMITS.max_factor)))
    return sheet


def _compare_images(reference: Reference, twin: Twin, pose: int) -> _Compared:
    images, black = reference.compared, np.float32(twin.parameters.black_level * reference.full_scale)
    real = reference.frames(pose, images) - black
    own = twin.expected(pose, reference.shown(images), reference.settings) - black
    own_square, both = np.einsum("nvu,nvu->vu", own, own), np.einsum("nvu,nvu->vu", own, real)
    real_square = np.einsum("nvu,nvu->vu", real, real)
    is_lit = own.mean(axis=0) > LIMITS.min_lit_level * reference.full_scale
    nothing = np.full_like(both, np.nan)
    ratio = np.divide(both, own_square, out=nothing.copy(), where=is_lit)
    likeness = np.sqrt(own_square * real_square)
    correlation = np.divide(both, likeness, out=nothing, where=is_lit & (likeness > 0))
    return _Compared(ratio, correlation, twin.parameters.poses[pose])


def _sheet_margins(reference: Reference, twin: Twin, compared: Sequence[_Compared], reach: float) -> Margins:
    """How far the sheet goes on beyond each side of the target."""
    margins = []
    for side in range(4):
        widths = []
        for pose in compared:
            away, values = _beyond_side(reference, twin, pose, pose.as_sheet, NO_MARGINS, side)
            widths.append(_distance_until(away, values > LIMITS.min_blank_share, reach))
        measured = [width for width in widths if width is not None]
        margins.append(float(np.median(measured)) if measured else 0.0)
    return margins[0], margins[1], margins[2], margins[3]


def _rim_mm(beyond: Sequence[Sequence[_Strip]], reach: float) -> float:
    """Width of the frame: as far as it is dark beyond the sheet on all sides; a shadow falls to one alone."""
    of_poses = []
    for sides in beyond:
        widths = [
            _distance_until(away, ratio < LIMITS.max_dark_share, reach, LIMITS.blurred_mm)
            for away, ratio in sides
        ]
        measured = [width for width in widths if width is not None]
        if measured:
            width = min(measured)
            of_poses.append(width if width > LIMITS.blurred_mm else 0.0)
    return float(np.median(of_poses)) if of_poses else 0.0


def _rim_reflectance(beyond: Sequence[Sequence[_Strip]], rim_mm: float, paper: float) -> float:
    """Reflectance of the frame, whose light the ratios compare with that of blank paper in its place."""
    within = (LIMITS.blurred_mm, rim_mm - LIMITS.blurred_mm)
    within_rim = [ratio[(away > within[0]) & (away < within[1])] for sides in beyond for away, ratio in sides]
    ratios = np.concatenate(within_rim)
    return float(np.clip(np.median(ratios) * paper, 0.0, 1.0)) if len(ratios) else 0.0


def _distance_until(away_mm: Floats, holds: Mask, reach: float, first: float = 0.0) -> float | None:
    """Distance, from the first on, up to which something holds for most pixels; None where no end is seen."""
    for width in np.arange(first, reach, LIMITS.ring_mm):
        ring = (away_mm >= width) & (away_mm < width + LIMITS.ring_mm)
        if ring.sum() < LIMITS.min_ring_pixels:
            return None
        if holds[ring].mean() < 0.5:
            return float(width)
    return None


def _beyond_side(
    reference: Reference, twin: Twin, compared: _Compared, values: LevelStack, margins: Margins, side: int
) -> _Strip:
    """Distances in mm beyond a side of the sheet, and the values of pixels that see its plane lit there."""
    rows, columns = np.nonzero(np.isfinite(values))
    slopes = twin.parameters.calibration.camera.normalise(
        np.stack([columns, rows], axis=-1).astype(np.float64)
    )
    rays = np.column_stack([slopes, np.ones(len(slopes))])
    normal = compared.pose.rotation[:, 2]
    depth = (normal @ compared.pose.translation) / (rays @ normal)
    x, y, _ = compared.pose.inverse().apply(depth[:, None] * rays).T
    half_x, half_y = 0.5 * np.array(reference.target.size_mm)
    away = (-x - half_x, -y - half_y, x - half_x, y - half_y)[side] - margins[side]
    along = (np.abs(y) < half_y) if side % 2 == 0 else (np.abs(x) < half_x)
    kept = along & (away >= 0)
    return away[kept], values[rows[kept], columns[kept]]


def _sheet_texture(
    reference: Reference, twin: Twin, compared: Sequence[_Compared], margins: Margins
) -> NDArray[np.float32]:
    """Median over the poses of the factor, relative to that of the whole sheet; 1 where it is not known."""
    camera = twin.parameters.calibration.camera
    nearest = min(float(pose.pose.translation[2]) for pose in compared)
    per_mm = float(camera.matrix[0, 0]) / nearest / LIMITS.texture_px
    width, height = reference.target.size_mm
    left, top, right, bottom = margins
    x = np.arange(-0.5 * width - left, 0.5 * width + right, 1.0 / per_mm) + 0.5 / per_mm
    y = np.arange(-0.5 * height - top, 0.5 * height + bottom, 1.0 / per_mm) + 0.5 / per_mm
    places = np.stack([*np.meshgrid(x, y), np.zeros((len(y), len(x)))], axis=-1)
    factors = []
    for pose in compared:
        pixels = camera.project(places.reshape(-1, 3), pose.pose).astype(np.float32)
        u, v = pixels.reshape(len(y), len(x), 2).transpose(2, 0, 1)
        factors.append(cv2.remap(pose.ratio, u, v, cv2.INTER_LINEAR, borderValue=(np.nan,)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a place that is lit in no pose
        factor: LevelStack = np.nanmedian(np.stack(factors), axis=0)
    return np.clip(np.nan_to_num(factor, nan=1.0), 0, np.float32(LIMITS.max_factor))
