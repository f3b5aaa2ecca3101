"""Limits of detection; a named tuple, because compiled functions read them."""

from typing import NamedTuple


class TargetLimits(NamedTuple):
    """Limits of the detection of targets."""

    min_points: int = 6  # of a board, for its pose (chosen: two more than a homography needs)
    min_model_pixels: int = 25  # around a point, for the parameters of its model (chosen)
    max_scale_ratio: float = 2.4  # of scales along two directions (derived: that of a tilt of 65 degrees)
    min_correlation: float = 0.75  # of the image around a point with the model of the point (chosen)
    min_edge_share: float = 0.9  # of each side's edge in view at which the background must end (chosen)
    ground_tolerance: float = 0.25
    """Of the background, and of what lies beyond the edge, in contrasts (chosen)"""
    max_lattice_offset: float = 0.2  # of a point from where the lattice has it, in steps (chosen)
    max_fit_steps: int = 100  # steps of the fit of one point (chosen)
    centre_tolerance_px: float = 1e-6  # the centre of a point has converged when it moves by less (chosen)
    edge_blurs: float = 4.5
    """Distance from an edge, in blurs, beyond which the model is ±1 (derived: to 2e-10)"""
    min_halved_px: int = 600
    """Smaller pictures are searched as they are, larger ones at half the size (chosen)"""
    max_refinement_px: int = 5  # half the window of a corner of the halved picture in the whole one (chosen)
    circle_rim: float = 0.1  # background around a circle, as a share of its diameter (chosen)


TARGET_LIMITS = TargetLimits()
