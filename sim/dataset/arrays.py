"""Computes the arrays of a sample from its frames and labels."""

from __future__ import annotations

import numpy as np

from fpplab.core.conventions import Image, axis_length, phase_of_coordinate
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode, wrapped_phase
from sim.dataset.fields import FRAMES, Arrays
from sim.dataset.labels import Labels
from sim.studio import SceneTruth


def sample_arrays(
    frames: list[Image], plan: Plan, exposure_s: float, bits: int, truth: SceneTruth, labels: Labels
) -> Arrays:
    """Compute every field of a sample, as `FIELDS` describes them."""
    # frames (height, width)
    devices = truth.calibration
    size = devices.projector.size
    recording = Recording(frames, plan, size, bits)
    decoded = decode(recording)
    wrapped = [
        wrapped_phase(recording.of_set(index), fringe).phase for index, fringe in enumerate(plan.fringes)
    ]
    coordinates = {"x": labels.u, "y": labels.v}
    absolute = [
        phase_of_coordinate(coordinates[f.axis].astype(np.float64), f.stripes, axis_length(size, f.axis))
        for f in plan.fringes
    ]
    return {
        FRAMES: np.stack(frames),
        "exposure_s": np.array(exposure_s),
        "wrapped_phase": np.stack(wrapped),
        "decoded_u": decoded.u,
        "decoded_v": decoded.v,
        "decoded_sigma": decoded.sigma,
        "modulation": decoded.modulation,
        "absolute_phase": np.stack(absolute).astype(np.float32),
        "projector_u": labels.u,
        "projector_v": labels.v,
        "depth": labels.depth,
        "normals": labels.normals,
        "mask": labels.mask,
        "camera_matrix": devices.camera.matrix,
        "camera_distortion": devices.camera.distortion,
        "projector_matrix": devices.projector.matrix,
        "projector_distortion": devices.projector.distortion,
        "T_projector_camera": devices.T_projector_camera.matrix,
    }
