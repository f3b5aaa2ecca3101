"""Searches for the start of a fit, where a step from the present parameters would not lead there.

Focus and aperture are searched on a coarse grid. The light of a lamp of the room follows the board's tilt and
distance, as even ambient light does not: for each of a grid of directions the levels are linear in its
irradiance, so that the best direction is found by least squares. `light_fit.fit_light` goes on from there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from scipy.optimize import lsq_linear

from fpplab.core.conventions import Floats
from sim.matching.light.light_fit import level_slopes, light_residuals, mean_square_difference
from sim.matching.loss import level_weights
from sim.matching.reference import Reference
from sim.matching.samples import LightSample, PixelSample
from sim.parameters import ADJUSTABLE, TwinParameters
from sim.twin import Twin


@dataclass(frozen=True)
class LampGrid:
    """Lamps from which the fit of a lamp of the room may start (chosen)."""

    angles_deg: tuple[float, ...] = (25.0, 50.0, 75.0)
    azimuths_deg: tuple[float, ...] = tuple(45.0 * n - 180.0 for n in range(8))
    distance_mm: float = 1500.0  # from the point that they light
    irradiance: float = 0.02  # relative to the projector's white, for which the effect of each is computed


LAMPS = LampGrid()


def search_lamp(
    reference: Reference, twin: Twin, samples: Sequence[PixelSample], names: Sequence[str]
) -> TwinParameters:
    """Search a grid of directions for a lamp of the room, to find a start for a fit of its place."""
    start = replace(twin.parameters, lamp_irradiance=0.0)
    dark = twin.with_parameters(start)
    residuals = partial(light_residuals, reference, samples=samples)
    residual = residuals(dark)
    weight = np.sqrt(level_weights(residual)[0])
    others = level_slopes(residuals, dark, names, residual)
    best, lowest = start, np.inf
    lower = np.array([*np.full(len(names), -np.inf), 0.0])
    for angle in LAMPS.angles_deg:
        for azimuth in LAMPS.azimuths_deg:
            lamp = replace(
                start, lamp_angle_deg=angle, lamp_azimuth_deg=azimuth, lamp_distance_mm=LAMPS.distance_mm
            )
            lit = twin.with_parameters(replace(lamp, lamp_irradiance=LAMPS.irradiance))
            own = (residual - residuals(lit)) / LAMPS.irradiance
            matrix = np.column_stack([others, own]) * weight[:, None]
            # On normal equations, which are few: least squares with a bound would copy all levels.
            scale = np.sqrt(np.sum(matrix**2, axis=0))
            scale[scale == 0] = 1.0
            root = np.linalg.cholesky((matrix / scale).T @ (matrix / scale) + 1e-9 * np.eye(len(scale)))
            right = np.linalg.solve(root, (matrix / scale).T @ (weight * residual))
            solution = lsq_linear(root.T, right, (lower, np.inf))
            if solution.cost - 0.5 * right @ right < lowest:
                lowest = solution.cost - 0.5 * right @ right
                best = _step_parameters(lamp, names, solution.x / scale)
    return best


def _step_parameters(lamp: TwinParameters, names: Sequence[str], step: Floats) -> TwinParameters:
    changed = replace(lamp, lamp_irradiance=min(float(step[-1]), ADJUSTABLE["lamp_irradiance"].fit.upper))
    for name, by in zip(names, step[:-1].tolist(), strict=True):
        knob = ADJUSTABLE[name]
        changed = knob.with_value(changed, knob.read(changed) + by)
    return changed


def focus_distances(parameters: TwinParameters, focus: str) -> list[float]:
    """Give distances at which a focus may be, by those of the board's poses."""
    depths = np.array([pose.translation[2] for pose in parameters.poses])
    if focus == "projector_focus_mm":
        to_projector = parameters.calibration.T_projector_camera
        depths = np.array([to_projector.apply(pose.translation)[2] for pose in parameters.poses])
    middle, half = float(np.median(depths)), max(float(np.ptp(depths)), 0.05 * float(np.median(depths)))
    return [middle + share * half for share in (-0.4, 0.0, 0.4)]


def search_focus_grid(
    reference: Reference,
    twin: Twin,
    samples: Sequence[LightSample],
    focus: str,
    aperture: str,
    apertures: Sequence[float],
) -> TwinParameters:
    """Search a coarse grid of focus distance and aperture, to find a start for a fit of both."""
    start = twin.parameters
    own = float(getattr(start, aperture))
    grid = [(depth, own * opening) for depth in focus_distances(start, focus) for opening in apertures]
    best, lowest = start, mean_square_difference(reference, twin, samples)
    for depth, opening in grid:
        changes: dict[str, Any] = {focus: depth, aperture: opening}
        tried = replace(start, **changes)
        mean_square = mean_square_difference(reference, twin.with_parameters(tried), samples)
        if mean_square < lowest:
            best, lowest = tried, mean_square
    return best
