"""Search for a lamp of the room: light beside the projector's that comes from one side.

Its light follows the board's tilt and distance, as even ambient light does not. For each of a grid of
directions the levels are linear in its irradiance, so that the best direction is found by least squares;
`sim.matching.light.light_fit.fit_light` goes on from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import lsq_linear

from fpplab.core.conventions import Floats
from sim.matching.light.light_fit import ADJUSTABLE, level_slopes, light_residuals
from sim.matching.loss import level_weights
from sim.matching.reference import Reference
from sim.matching.samples import PixelSample
from sim.parameters import TwinParameters
from sim.twin import Twin

ANGLES_DEG = (25.0, 50.0, 75.0)
AZIMUTHS_DEG = tuple(45.0 * n - 180.0 for n in range(8))
DISTANCE_MM = 1500.0
PROBE = 0.02
"""Irradiance of the lamp whose effect is computed for each direction."""


def search_lamp(
    reference: Reference, twin: Twin, samples: Sequence[PixelSample], names: Sequence[str]
) -> TwinParameters:
    """Search a grid of directions for a lamp of the room, to find a start for a fit of its place."""
    start = replace(twin.parameters, lamp_irradiance=0.0)
    dark = twin.with_parameters(start)
    residual = light_residuals(reference, dark, samples)
    weight = np.sqrt(level_weights(residual)[0])
    others = level_slopes(reference, dark, names, samples, residual)
    best, least = start, np.inf
    lower = np.array([*np.full(len(names), -np.inf), 0.0])
    for angle in ANGLES_DEG:
        for azimuth in AZIMUTHS_DEG:
            lamp = replace(
                start, lamp_angle_deg=angle, lamp_azimuth_deg=azimuth, lamp_distance_mm=DISTANCE_MM
            )
            lit = twin.with_parameters(replace(lamp, lamp_irradiance=PROBE))
            own = (residual - light_residuals(reference, lit, samples)) / PROBE
            matrix = np.column_stack([others, own]) * weight[:, None]
            # On normal equations, which are few: least squares with a bound would copy all levels.
            scale = np.sqrt(np.sum(matrix**2, axis=0))
            scale[scale == 0] = 1.0
            root = np.linalg.cholesky((matrix / scale).T @ (matrix / scale) + 1e-9 * np.eye(len(scale)))
            wanted = np.linalg.solve(root, (matrix / scale).T @ (weight * residual))
            found = lsq_linear(root.T, wanted, (lower, np.inf))
            if found.cost - 0.5 * wanted @ wanted < least:
                least = found.cost - 0.5 * wanted @ wanted
                best = _stepped(lamp, names, found.x / scale)
    return best


def _stepped(lamp: TwinParameters, names: Sequence[str], step: Floats) -> TwinParameters:
    changed = replace(lamp, lamp_irradiance=min(float(step[-1]), ADJUSTABLE["lamp_irradiance"].upper))
    for name, by in zip(names, step[:-1].tolist(), strict=True):
        knob = ADJUSTABLE[name]
        changed = knob.with_value(changed, knob.read(changed) + by)
    return changed
