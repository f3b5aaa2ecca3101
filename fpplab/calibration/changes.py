"""Changes of a rig since its characterisation: what people would call them, as changes of the parameters."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fpplab.calibration.model import PARAMETERS, Calibration
from fpplab.core.conventions import Floats
from fpplab.core.geometry import Pinhole, RigidTransform

TURN_DEG, SHIFT_MM, ZOOM, PICTURE_PX = 0.1, 1.0, 0.004, 3.0
"""Sizes of changes that happen without being noticed: turns, shifts, relative focal lengths, and places of
the picture on the sensor or the mirrors. Chosen."""


def parameter_vector(calibration: Calibration) -> Floats:
    """List the parameters in the order of `PARAMETERS`."""
    pose = calibration.T_projector_camera
    camera, projector = calibration.camera.intrinsics, calibration.projector.intrinsics
    return np.concatenate([camera, projector, pose.rotation_vector, pose.translation])


def _with_lens(calibration: Calibration, device: str, factor: float, shift_px: Floats) -> Calibration:
    def changed(lens: Pinhole) -> Pinhole:
        matrix = lens.matrix.copy()
        matrix[[0, 1], [0, 1]] *= factor
        matrix[:2, 2] += shift_px
        return replace(lens, matrix=matrix)

    if device == "camera":
        return replace(calibration, camera=changed(calibration.camera))
    return replace(calibration, projector=changed(calibration.projector))


def changed_rigs(calibration: Calibration) -> dict[str, Calibration]:
    """List the calibrations after each kind of change, by what people would call the change."""
    return {name: rig for rigs in changes_by_part(calibration).values() for name, rig in rigs.items()}


def changes_by_part(calibration: Calibration) -> dict[str, dict[str, Calibration]]:
    """List the same by what has changed: the place of the devices, or the lens and picture of one."""
    pose, unit = calibration.T_projector_camera, np.eye(3)
    moved: dict[str, Calibration] = {}
    for axis, direction in zip("xyz", unit, strict=True):
        turn = RigidTransform.from_vectors(np.radians(TURN_DEG) * direction, np.zeros(3))
        shift = RigidTransform.from_vectors(np.zeros(3), SHIFT_MM * direction)
        about = f"turned by {TURN_DEG:g}° about its {axis} axis"
        shifted = f"the projector moved by {SHIFT_MM:g} mm along the camera's {axis} axis"
        poses = {
            f"the projector {about}": turn @ pose,
            f"the camera {about}": pose @ turn,
            shifted: pose @ shift,
        }
        moved |= {name: replace(calibration, T_projector_camera=new) for name, new in poses.items()}
    parts = {"projector or camera moved": moved}
    for device in ("camera", "projector"):
        zoomed = f"the lens of the {device} zoomed by {100 * ZOOM:g} %"
        of_device = {zoomed: _with_lens(calibration, device, 1.0 + ZOOM, np.zeros(2))}
        for direction, word in zip(unit[:2, :2], ("sideways", "up or down"), strict=True):
            name = f"the picture of the {device} {PICTURE_PX:g} px further {word}"
            of_device[name] = _with_lens(calibration, device, 1.0, PICTURE_PX * direction)
        parts[f"{device}'s lens or picture changed"] = of_device
    return parts


def kinds_by_part(calibration: Calibration, names: Sequence[str]) -> dict[str, Floats]:
    """Compute by how much each kind of change of a part changes some parameters."""
    # names of n parameters; returns (n, kinds) by part
    stated, rows = parameter_vector(calibration), [PARAMETERS.index(name) for name in names]
    return {
        part: np.stack([parameter_vector(rig) - stated for rig in rigs.values()], axis=1)[rows]
        for part, rigs in changes_by_part(calibration).items()
    }
