"""Limits of detection; a named tuple, because compiled functions read them."""

from __future__ import annotations

from typing import NamedTuple


class TargetLimits(NamedTuple):
    """Limits of the detection of targets."""

    min_points: int = 6
    """Fewer points of a board do not determine its pose well enough. Chosen: two more than a homography
    needs."""
    min_model_pixels: int = 25
    """Fewer pixels around a point do not determine the parameters of its model. Chosen."""
    max_scale_ratio: float = 2.4
    """Greatest ratio of a board's scales along two directions. Derived: that of a tilt of 65 degrees."""
    min_correlation: float = 0.75
    """Least correlation of the image around a point with the model of the point. Chosen."""
    min_edge_share: float = 0.9
    """Least share of each side's edge in view at which the background must end. Chosen."""
    ground_tolerance: float = 0.25
    """Tolerance on the background's brightness, and least distance of what lies beyond the edge, in
    contrasts. Chosen."""
    max_lattice_offset: float = 0.2
    """How far a point of the lattice may be from where it is expected, in steps. Chosen."""
    max_fit_steps: int = 100  # steps of the fit of one point (chosen)
    centre_tolerance_px: float = 1e-6  # the centre of a point has converged when it moves by less (chosen)
    edge_blurs: float = 4.5
    """Distance from an edge, in parameters of its blur, beyond which the model is constant. Derived: it is ±1
    to within 2e-10 there."""
    min_halved_px: int = 600
    """Smaller pictures are searched as they are, larger ones at half the size first. Chosen."""
    max_refinement_px: int = 5
    """Half the window in which a corner of a picture of half the size is located in the whole one. Chosen."""
    circle_rim: float = 0.1
    """Background that a circle needs around it to be found, as a share of its diameter. Chosen."""


TARGET_LIMITS = TargetLimits()
