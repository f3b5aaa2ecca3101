"""Calibrations that no pair of devices can have, refused where they come in."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from fpplab.core.conventions import Lattice
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.core.units import MM


@dataclass(frozen=True)
class PossibleRigLimits:
    """Limits of what a pair of devices can be; all are chosen far from what real ones are."""

    max_aspect: float = 1.35
    """Ratio of fy / fx to that of the lattice, or its inverse. Pixels are square to 1 %; a projector
    that shows a picture of 4:3 on 16:9 has 1.33."""
    max_sizes_outside: float = 2.0
    """Distance of the principal point from the image, in sizes of the image. Projectors with lens shift stay
    below one; a camera's region of interest in the corner of a sensor five times as large has two."""
    max_share_without_ray: float = 0.1
    """Share of the image where the distortion cannot be inverted. Polynomials that were fitted to few poses
    fail at the corners, which measure nothing."""
    max_stretch: float = 1.5
    """Distorted by undistorted distance from the principal point, at any pixel. Lenses reach 1.1."""
    min_baseline_mm: float = 1.0
    """Distance of camera and projector. Lenses that are nearer to each other do not exist; 0.2 is m."""
    max_baseline_mm: float = 20_000.0
    """The same. Halls are measured with less."""


LIMITS = PossibleRigLimits()

ASPECTS = {Lattice.SQUARE: (1.0, 2.0), Lattice.DIAMOND: (2.0,)}
"""fy / fx of projectors: rows of a diamond lattice lie half as far apart as its columns, also where it is
taken for a square one."""

_GRID = 33  # points of an image along each side at which its lens is tried (chosen)
_DEPTHS = np.geomspace(0.25, 200.0, 60)
"""Distances in baselines at which both devices may see the same point. Chosen."""


def explain_impossible(camera: Pinhole, projector: Pinhole, T_projector_camera: RigidTransform) -> str | None:
    """Explain why no camera and projector can be like this; None if some can."""
    faults = [*_lens_faults("camera", camera), *_lens_faults("projector", projector)]
    faults = faults or list(_pose_faults(camera, projector, T_projector_camera))
    return "; ".join(faults) or None


def _lens_faults(name: str, device: Pinhole) -> Iterator[str]:
    fx, fy = np.diag(device.matrix)[:2]
    aspects = (1.0,) if name == "camera" else ASPECTS[device.lattice]
    if all(max(fy / fx / aspect, aspect * fx / fy) > LIMITS.max_aspect for aspect in aspects):
        ranges = " or ".join(f"{a / LIMITS.max_aspect:.3g} to {a * LIMITS.max_aspect:.3g}" for a in aspects)
        yield (
            f"the {name}'s focal lengths fx {fx:.6g} px and fy {fy:.6g} px are not those of a lens on a "
            f"{device.lattice} lattice: fy / fx is {fy / fx:.3g}, but must be {ranges}"
        )
    for axis, size, centre in zip("xy", device.size, device.matrix[:2, 2].tolist(), strict=True):
        margin = LIMITS.max_sizes_outside * size
        if not -margin <= centre <= size + margin:
            yield (
                f"the {name}'s principal point is {centre:.6g} px in {axis}, far outside its image of {size} "
                f"px: it must be between {-margin:g} and {size + margin:g}"
            )
    yield from _distortion_faults(name, device)


def _distortion_faults(name: str, device: Pinhole) -> Iterator[str]:
    sides = (np.linspace(0.0, size - 1.0, _GRID) for size in device.size)
    pixels = np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2)
    rays = device.normalise(pixels)
    has_ray = np.isfinite(rays).all(axis=-1)
    coefficients = ", ".join(f"{value:.4g}" for value in device.coefficients)
    without_ray = 1.0 - float(has_ray.mean())
    if without_ray > LIMITS.max_share_without_ray:
        yield (
            f"the {name}'s distortion ({coefficients}) folds the image over: {100 * without_ray:.0f} % of it "
            f"cannot be undistorted, more than {100 * LIMITS.max_share_without_ray:.0f} %"
        )
        return
    slopes = (pixels - device.matrix[:2, 2]) / np.diag(device.matrix)[:2]
    distance = np.hypot(*rays[has_ray].T)
    stretch = float((np.hypot(*slopes[has_ray].T) / np.maximum(distance, 1e-12)).max())
    if stretch > LIMITS.max_stretch:
        yield (
            f"the {name}'s distortion ({coefficients}) is beyond that of a lens: it moves pixels outwards by "
            f"a factor of {stretch:.3g}, more than {LIMITS.max_stretch:g}"
        )


def _pose_faults(camera: Pinhole, projector: Pinhole, pose: RigidTransform) -> Iterator[str]:
    baseline = float(np.linalg.norm(pose.translation))
    if not _is_possible_baseline(baseline):
        units = [unit for unit in ("um", "cm", "inch", "m") if _is_possible_baseline(baseline * MM[unit])]
        advice = f" (fpplab convert --unit {' or '.join(units)})" if units else ""
        yield (
            f"camera and projector stand {baseline:.4g} mm apart, but must stand between "
            f"{LIMITS.min_baseline_mm:g} and {LIMITS.max_baseline_mm:g} mm apart; were lengths in another "
            f"unit than mm?{advice}"
        )
    elif not _see_the_same(camera, projector, pose):
        yield (
            "camera and projector do not look at the same space: no point that the camera sees up to "
            f"{_DEPTHS[-1] * baseline:.3g} mm away lies in the projector's image; are "
            "rotation and translation those from the camera's frame to the projector's?"
        )


def _is_possible_baseline(mm: float) -> bool:
    return LIMITS.min_baseline_mm <= mm <= LIMITS.max_baseline_mm


def _see_the_same(camera: Pinhole, projector: Pinhole, pose: RigidTransform) -> bool:
    sides = (np.linspace(0.0, size - 1.0, _GRID) for size in camera.size)
    slopes = camera.normalise(np.stack(np.meshgrid(*sides), axis=-1).reshape(-1, 2))
    slopes = slopes[np.isfinite(slopes).all(axis=-1)]
    rays = np.c_[slopes, np.ones(len(slopes))]
    depths = _DEPTHS * np.linalg.norm(pose.translation)
    return any(projector.sees(depth * rays, pose).any() for depth in depths)
