"""Coordinates -> points: triangulate, and remove what lies on no surface."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.errors import DataError
from fpplab.patterns.plan import Plan
from fpplab.phase import Decoded
from fpplab.reconstruction.filtering import apply_filter
from fpplab.reconstruction.triangulation import coded_maps, solve_pixels


def points_of(
    decoded: Decoded, calibration: Calibration, plan: Plan, texture: NDArray[np.uint8] | None = None
) -> tuple[Decoded, Cloud]:
    # texture (height, width)
    cloud = triangulate(decoded, calibration, texture, normals=plan.filter is None)
    return apply_filter(decoded, cloud, plan, calibration.projector.size)


def triangulate(
    decoded: Decoded,
    calibration: Calibration,
    texture: NDArray[np.uint8] | None = None,
    normals: bool = True,
) -> Cloud:
    # Where two axes are coded a pixel needs both, and each is weighted by its inverse variance. Left out are
    # points behind a device, outside the projector's image or where its distortion folds back, and pixels
    # without a solution.
    # decoded (height, width) px; texture (height, width); returns (N, 3) mm
    height, width = decoded.u.shape
    calibration.check_camera((width, height), "decoded maps")
    if texture is not None and texture.shape != (height, width):
        raise DataError(
            f"texture: {texture.shape[1]} x {texture.shape[0]} pixels, but the maps have {width} x {height}; "
            "take it from the same session"
        )
    coded = coded_maps(decoded, texture)
    solutions = solve_pixels(coded, calibration)
    points, pixels = solutions.points, solutions.pixels
    cloud = Cloud(
        points=points,
        pixels=pixels,
        size=(width, height),
        colour=None if texture is None else solutions.colour,
        sigma_noise_mm=solutions.sigma,
        epipolar_px=solutions.epipolar if len(coded.u) and len(coded.v) else None,
        sigma_phase_error_mm=None if decoded.sigma_phase_error is None else solutions.phase_error,
    )
    return replace(cloud, normals=cloud.grid().normals()) if normals else cloud


def cost_at_edges(decoded: Decoded, cloud: Cloud) -> dict[str, Any] | None:
    blur = decoded.edges
    if blur is None or cloud.sigma_noise_mm is None:
        return None
    um_per_px = 1e3 * np.median(cloud.sigma_noise_mm) / np.nanmedian(decoded.sigma)
    rms_um = float(blur.rms_px * um_per_px)
    return {"share": blur.share, "displacement_um": rms_um, "corrected": blur.is_corrected}
