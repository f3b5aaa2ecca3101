"""What the geometry of a characterised rig and its present light promise for a plan at a working distance."""

import math
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.clouds import Cloud
from fpplab.core.conventions import AXES, Floats, Mask, axis_length
from fpplab.core.depth import DepthRange
from fpplab.core.errors import ConfigError
from fpplab.diagnosis.points import triangulation_angles_deg
from fpplab.diagnosis.sample import FrameSample
from fpplab.patterns.plan import Plan
from fpplab.phase.coded_axes import axes_by_codes, coded_coordinate
from fpplab.phase.limits import CODES
from fpplab.phase.precision import coordinate_uncertainty
from fpplab.reconstruction.uncertainty import with_uncertainty
from fpplab.setup.live.regions import REGIONS, region_medians

RAYS = (24, 36)  # (rows, columns) of the camera's rays that sample its field (chosen)


@dataclass(frozen=True, eq=False)
class RigGeometry:
    """Both fields of a characterised rig, and where it is to measure."""

    calibration: Calibration  # of the rig
    stated: DepthRange | None = None  # distances between which everything lies, where they are stated

    @cached_property
    def rays(self) -> Floats:
        """(`RAYS`, 3) rays (x/z, y/z, 1) spread over the camera's image, in its frame."""
        width, height = self.calibration.camera.size
        v, u = np.meshgrid(
            *(_centres(n, size) for n, size in zip(RAYS, (height, width), strict=True)), indexing="ij"
        )
        slopes = self.calibration.camera.normalise(np.stack([u, v], axis=-1))
        return np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1)

    @cached_property
    def meeting_mm(self) -> float:
        """Distance from the camera at which both devices' middle rays come nearest to each other."""
        calibration, pose = self.calibration, self.calibration.T_projector_camera.inverse()
        middles = [(np.array(device.size) - 1) / 2 for device in (calibration.camera, calibration.projector)]
        slopes = [
            device.normalise(middle)
            for device, middle in zip((calibration.camera, calibration.projector), middles, strict=True)
        ]
        camera, projector = (np.append(slope, 1.0) for slope in slopes)
        along = np.stack([camera, -pose.rotation @ projector], axis=1)
        distance_mm, _ = np.linalg.lstsq(along, pose.translation, rcond=None)[0]
        if distance_mm <= 0:
            raise ConfigError(
                "calibration: the middle rays of camera and projector do not meet in front of the camera; "
                "state the working distance with --distance"
            )
        return float(distance_mm)

    def overlap(self, distance_mm: float) -> float:
        return float(self.rays_lit_at(distance_mm).mean())

    def outline(self, distance_mm: float) -> Floats:
        # returns (K, 3) mm
        points = (self.rays * distance_mm)[self.rays_lit_at(distance_mm)]
        if len(points) < 3:
            return np.empty((0, 3))
        hull = cv2.convexHull(points[:, :2].astype(np.float32))[:, 0].astype(np.float64)
        closed = np.concatenate([hull, hull[:1]])
        return np.concatenate([closed, np.full((len(closed), 1), distance_mm)], axis=1)

    @cached_property
    def depth_mm(self) -> tuple[float, float]:
        """Nearest and farthest distance in mm: as stated, or where the overlap is 0.8 of its greatest."""
        if self.stated is not None:
            return self.stated.mm
        distances = np.linspace(0.5, 2.0, 46) * self.meeting_mm
        shares = np.array([self.overlap(d) for d in distances])
        overlapping = distances[shares >= 0.8 * shares.max()] if shares.max() > 0 else distances[:0]
        if not len(overlapping):
            return self.meeting_mm, self.meeting_mm
        return float(overlapping[0]), float(overlapping[-1])

    def rays_lit_at(self, distance_mm: float) -> Mask:
        has_ray = np.isfinite(self.rays).all(axis=-1)
        points = np.where(has_ray[..., None], self.rays, 1.0) * distance_mm
        return np.asarray(
            has_ray & self.calibration.projector.sees(points, self.calibration.T_projector_camera)
        )


@dataclass(frozen=True, eq=False)
class WorkingPoint:
    """What a rig's geometry provides at one distance."""

    geometry: RigGeometry  # of the rig
    plan: Plan  # that will be measured with
    distance_mm: float  # from the camera, in mm

    @cached_property
    def _points_in_both_views(self) -> Floats:
        """(N, 3) points in mm that both devices see."""
        lit = self.geometry.rays_lit_at(self.distance_mm)
        return np.asarray(self.geometry.rays[lit] * self.distance_mm)

    @cached_property
    def angle_deg(self) -> float | None:
        """Angle of triangulation in degrees, the median; None where the fields do not overlap."""
        if not len(self._points_in_both_views):
            return None
        return float(
            np.median(triangulation_angles_deg(self._points_in_both_views, self.geometry.calibration))
        )

    @cached_property
    def px_per_mm(self) -> Floats:
        """(`REGIONS`, 2) change of the projector's u and v for 1 mm along the ray; NaN where unseen."""
        calibration = self.geometry.calibration
        points = self.geometry.rays * self.distance_mm
        lit = self.geometry.rays_lit_at(self.distance_mm)
        unit = self.geometry.rays / np.linalg.norm(self.geometry.rays, axis=-1, keepdims=True)
        near, far = (
            calibration.projector.project(points + s * unit, calibration.T_projector_camera)
            for s in (-0.5, 0.5)
        )
        return np.stack([region_medians(np.abs(far - near)[..., k], lit) for k in range(2)], axis=-1)

    @cached_property
    def calibration_um(self) -> tuple[float, float] | None:
        """Standard uncertainty by the calibration in µm, of position and of form; None where not known."""
        calibration = self.geometry.calibration
        if calibration.uncertainty is None or not len(self._points_in_both_views):
            return None
        noise = (1.0 if "x" in self.plan.axes else np.inf, 1.0 if "y" in self.plan.axes else np.inf)
        cloud = with_uncertainty(Cloud(self._points_in_both_views.astype(np.float32)), calibration, noise)
        assert cloud.sigma_calibration_mm is not None
        assert cloud.sigma_form_mm is not None
        position, form = (
            1e3 * float(np.median(s)) for s in (cloud.sigma_calibration_mm, cloud.sigma_form_mm)
        )
        return position, form

    def summary(self) -> dict[str, object]:
        position, form = self.calibration_um or (None, None)
        return {
            "distance_mm": self.distance_mm,
            "depth_mm": list(self.geometry.depth_mm),
            "overlap": self.geometry.overlap(self.distance_mm),
            "angle_deg": self.angle_deg,
            "calibration_um": position,
            "form_um": form,
        }

    def noise_um(self, sample: FrameSample) -> Floats:
        fine = sample.fits[sample.recording.plan.finest_set()]
        widest, lit = sample.widest, sample.measured
        modulation = region_medians(widest.modulation, lit)
        contrast = region_medians(fine.modulation / np.maximum(widest.modulation, 1e-9), lit)
        # Rounding that repeats in all pixels of the same light is no noise, as in the points of a scan.
        variance = sample.errors.noise.variance(widest.offset) - sample.errors.noise.repeated(widest.offset)
        noise = region_medians(np.sqrt(np.maximum(variance, 0.0)), lit)
        square_px = _blur_square(sample, contrast)
        information, fringes = np.zeros(REGIONS), self.plan.fringe_part
        size = self.geometry.calibration.projector.size
        by_codes = axes_by_codes(self.plan, size)
        for axis in self.plan.axes:
            length, along = axis_length(size, axis), self.px_per_mm[..., AXES.index(axis)]
            if axis in by_codes:
                blur_px = float(np.sqrt(np.nanmedian(square_px)))
                tabulated = min(CODES.blurs_px, key=lambda each: abs(each - blur_px))
                small = CODES.noise_share
                per_noise = coded_coordinate(self.plan, axis, size, small, tabulated)[0] / small
                information += np.square(along * modulation / (per_noise * noise))
                continue
            assert fringes is not None  # without codes
            for k in fringes.sets_along(axis):
                fringe = fringes.fringes[k]
                reduced = modulation * np.exp(-2.0 * square_px * (math.pi * fringe.stripes / length) ** 2)
                sigma = coordinate_uncertainty(fringe.phase_noise * noise / reduced, fringe.stripes, length)
                information += np.square(along / sigma)
        with np.errstate(divide="ignore"):
            sigma_um = 1e3 / np.sqrt(information)
        return np.where(np.isfinite(sigma_um), sigma_um, np.nan)


def _blur_square(sample: FrameSample, contrast: Floats) -> Floats:
    """Square of the blur in projector px, a Gaussian's, from the contrast of the finest fringes."""
    plan = sample.recording.plan
    length = axis_length(sample.recording.projector_size, plan.axes[0])
    wide, fine = (
        plan.fringes[k].stripes / length for k in (plan.sets_along(plan.axes[0])[0], plan.finest_set())
    )
    if fine <= wide:
        return np.zeros_like(contrast)
    limited = np.clip(contrast, 1e-3, 1.0)  # fringes of less are noise
    return np.asarray(-np.log(limited) / (2.0 * math.pi**2 * (fine**2 - wide**2)))


def _centres(n: int, size: int) -> Floats:
    return np.asarray((np.arange(n) + 0.5) * size / n - 0.5)
