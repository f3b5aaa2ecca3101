"""Limits of reconstruction; a named tuple, because compiled functions read them."""

from __future__ import annotations

from typing import NamedTuple


class ReconstructionLimits(NamedTuple):
    """Limits of triangulation, filter, depth ranges and uncertainty."""

    depth_tolerance: float = 1e-5
    """Relative size of the last step in depth. Derived: each step squares the error, so the depth is good to
    1e-10."""
    max_steps: int = 20  # steps of Gauss-Newton for one pixel (chosen: from the pixel above one is enough)
    block_rows: int = 16  # rows that one thread solves in sequence, each starting from the row above (chosen)
    min_sensitivity_px_per_mm: float = 1e-3
    """Least change of the projector coordinates with depth that determines the depth. Chosen."""
    max_coordinate_px: float = 1e6
    """A coordinate beyond this, or an infinite one, is taken as not known. Chosen."""
    cached_cameras: int = 2  # number of cameras whose ray slopes are kept in memory (chosen)
    interval_margin_px: float = 0.5
    """By how much an interval reaches beyond the epipolar segment, for the calibration's own uncertainty.
    Chosen."""
    segment_points: int = 5
    """Points of an epipolar segment that are projected, evenly spaced in inverse depth, because distortion
    bends it a little. Chosen."""
    segment_grid_px: int = 16
    """Camera pixels between those whose segments are projected; the others are interpolated. Chosen."""
    blur_reach_px: int = 3
    """Distance from an edge within which a surface reaches its full modulation, the width of the blur.
    Chosen."""
    significant_sigmas: float = 5.0
    """Least significant loss of modulation, in standard deviations. Derived: the greatest of some forty
    neighbours is itself two or three standard deviations too great."""
    flying_noise_share: float = 0.5
    """Allowance for noise in a step to a neighbour where the majority of all decides, as a share of
    `fpplab.clouds.surfaces.NOISE_SIGMAS`. Measured on eight ray-cast scenes: 74 % of the flying
    points and 0.06 % of the good ones are removed; with the whole allowance 51 % and 0.03 %."""
    finer_steps: int = 6
    """Steps between two nodes of a ray grid at which cubic polynomials are evaluated; between these, values
    are linear. Chosen."""
    grid_sample_points: int = 20_000
    """About as many evenly sampled points tell where a ray grid lies. Chosen."""
    outside_grid_share: float = 0.001
    """Share of points at each end of each direction that a ray grid need not hold, such as lie on no surface.
    Chosen."""
    grid_margin_share: float = 0.05
    """By which share of its length a ray grid reaches beyond the others. Chosen."""
    block_points: int = 1 << 14  # points whose derivatives are in memory at a time: 12 MB (chosen)
    rigid_sample_points: int = 20_000
    """About as many evenly sampled points are used to fit the rigid motion of the cloud. Chosen."""
    hidden_change_points: int = 1000
    """About as many evenly sampled points tell what changes of the rig cost. Chosen: their RMS is smooth."""


RECONSTRUCTION_LIMITS = ReconstructionLimits()
