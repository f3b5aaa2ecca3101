"""A calibration made of what the joint adjustment found."""

from __future__ import annotations

from fpplab.calibration.board import FittedBoard, FittedErrors
from fpplab.calibration.model import Calibration, Uncertainty
from fpplab.characterisation.parameters import ErrorSizes, Model, Solution
from fpplab.characterisation.zhang import matrix_of, transform
from fpplab.core import config
from fpplab.core.conventions import Lattice
from fpplab.core.geometry import Pinhole
from fpplab.targets import Target


def calibration_of(
    target: Target,
    lattice: Lattice,
    solution: Solution,
    sizes: ErrorSizes,
    model: Model,
    rms_px: dict[str, float],
    uncertainty: Uncertainty,
) -> Calibration:
    assert model.image_sizes is not None
    errors = FittedErrors(
        camera_px=sizes.camera_px,
        projector_px=sizes.projector_px,
        camera_shared_px=sizes.camera_shared_px,
        projector_shared_px=sizes.projector_shared_px,
        poses=len(solution.poses),
        carried=solution.carried,
        scale=model.scale_tolerance,
    )
    camera_size, projector_size = model.image_sizes
    return Calibration(
        Pinhole(camera_size, matrix_of(solution.camera), solution.camera[4:]),
        Pinhole(projector_size, matrix_of(solution.projector), solution.projector[4:], lattice),
        transform(solution.T_projector_camera),
        rms_px,
        uncertainty,
        FittedBoard(config.plain(target), solution.board, errors),
    )
