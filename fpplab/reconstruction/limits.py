"""Limits of reconstruction; a named tuple, because compiled functions read them."""

from typing import NamedTuple


class ReconstructionLimits(NamedTuple):
    """Limits of triangulation, filter, depth ranges and uncertainty."""

    depth_tolerance: float = 1e-5  # relative size of the last step (derived: the depth is then good to 1e-10)
    max_steps: int = 20  # steps of Gauss-Newton for one pixel (chosen: from the pixel above one is enough)
    block_rows: int = 16  # rows that one thread solves in sequence, each starting from the row above (chosen)
    stretch_px: int = 512  # pixels of a row that are solved together, so that caches hold them (chosen)
    min_coded_share: float = 0.25
    """Of a stretch, for all its pixels to be solved at once (measured: each takes a quarter of the time)"""
    min_sensitivity_px_per_mm: float = 1e-3  # of coordinates with depth, for the depth (chosen)
    max_coordinate_px: float = 1e6
    """A coordinate beyond this, or an infinite one, is taken as not known (chosen)"""
    cached_cameras: int = 2  # number of cameras whose ray slopes are kept in memory (chosen)
    interval_margin_px: float = 0.5  # beyond the epipolar segment, for the calibration's uncertainty (chosen)
    segment_points: int = 5  # projected of an epipolar segment, which distortion bends a little (chosen)
    segment_grid_px: int = 16  # camera pixels between those whose segments are projected (chosen)
    blur_reach_px: int = 3  # from an edge within which a surface reaches its full modulation (chosen)
    significant_sigmas: float = 5.0
    """Of a loss of modulation (derived: the greatest of forty neighbours is two or three too great)"""
    flying_noise_share: float = 0.5
    """Allowance for noise in a step to a neighbour where the majority of all decides, as a share of
    `fpplab.clouds.surfaces.NOISE_SIGMAS`. Measured on eight ray-cast scenes: 74 % of the flying
    points and 0.06 % of the good ones are removed; with the whole allowance 51 % and 0.03 %."""
    finer_steps: int = 6  # between two nodes of a ray grid at which cubic polynomials are evaluated (chosen)
    grid_sample_points: int = 20_000  # about as many points tell where a ray grid lies (chosen)
    outside_grid_share: float = 0.001  # of points at each end that a ray grid need not hold (chosen)
    grid_margin_share: float = 0.05  # of its length by which a ray grid reaches beyond the others (chosen)
    block_points: int = 1 << 14  # points whose derivatives are in memory at a time: 12 MB (chosen)
    rigid_sample_points: int = 5_000  # about as many fit the rigid motion of the cloud (chosen: form to 1 %)
    hidden_change_points: int = 1000
    """About as many tell what changes of the rig cost (chosen: their RMS is smooth)"""


RECONSTRUCTION_LIMITS = ReconstructionLimits()
