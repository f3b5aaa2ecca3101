"""Scans of a part by formulas, with one thing or several wrong at the bench."""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import TWO_PI, Floats, axis_length, full_scale, raw_dtype
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.reconstruction.triangulation import camera_slopes

SIZE, PROJECTOR = (480, 320), (912, 1140)


def plan_of(
    axes: str = "x", steps: tuple[int, ...] = (6, 6, 12), stripes: tuple[int, ...] = (1, 8, 64)
) -> Plan:
    sets = [
        Sinusoid(axis=axis, stripes=s, steps=n) for axis in axes for s, n in zip(stripes, steps, strict=True)
    ]
    return Plan(fringes=tuple(sets))


PLAN = plan_of()


@dataclass(frozen=True)
class Bench:
    """What is right and wrong at a bench; as it stands, nothing is wrong."""

    plan: Plan = PLAN
    bits: int = 8
    seed: int = 0
    white: float = 0.8
    """Grey level of a white surface in full light, as a share of full scale."""
    ambient: float = 0.02
    """Other light, as a share of the projector's."""
    camera_blur_px: float = 0.7
    projector_blur_px: float = 0.6
    gamma: float = 1.0
    flicker: float = 0.002
    moves_px: float = 0.0
    """Standard deviation of the part's place in each frame."""
    baseline_mm: float = 150.0
    bulge_mm: float = 8.0
    full_well_e: float = 12000.0
    turned_deg: float = 0.0
    """By how much the projector was turned, about the camera's x axis, after it was calibrated."""
    lamp: float = 1.0
    drift_px: float = 0.0
    """By how much the projector's picture walks along each axis over the whole scan."""
    warms: float = 0.0
    """By what share the light changes over the whole scan."""
    off_mm: float = 0.0
    """How far the projector's field lies beside the camera's."""

    def rig(self, turned: bool = False) -> Calibration:
        focal = SIZE[0] / 169.0 * 450.0
        camera = Pinhole.from_focal(SIZE, (focal, focal), (239.0, 161.0), (-0.1, 0.08, 4e-4, 0, 0))
        projector = Pinhole.from_focal(PROJECTOR, (2150.0, 2150.0), (455.0, 570.0), (-0.03, 0.05, 0, 2e-4, 0))
        angle = np.arctan2(self.baseline_mm - self.off_mm, 450.0)
        tilt = np.radians(self.turned_deg) if turned else 0.0
        turn = RigidTransform.from_vectors(np.array([0.02 + tilt, angle, 0.01]), np.zeros(3))
        place = np.array([self.baseline_mm, 8.0, 10.0])
        return Calibration(camera, projector, RigidTransform(turn.rotation, -turn.rotation @ place), {})

    def recording(self) -> Recording:
        random = np.random.default_rng([17, self.seed])
        calibration = self.rig(turned=True)
        _, albedo = self._part(random)
        points = self.truth()
        seen = calibration.projector.project(points, calibration.T_projector_camera)
        inside = np.all((seen > -0.5) & (seen < np.array(PROJECTOR) - 0.5), axis=-1)
        frames = [
            self._exposed(k, step, seen, albedo, inside, random, n / (self.plan.images - 1))
            for n, (k, step, _) in enumerate(self.plan.steps())
        ]  # fmt: skip
        return Recording(frames, self.plan, PROJECTOR, self.bits, "scan")

    def truth(self) -> Floats:
        """Where every pixel's point lies in the camera's frame, (height, width, 3) in mm."""
        depth, _ = self._part(np.random.default_rng([17, self.seed]))
        return np.stack([*(s * depth for s in camera_slopes(self.rig().camera)), depth], axis=-1)

    def _part(self, random: np.random.Generator) -> tuple[Floats, Floats]:
        """Depth and albedo by pixel: a bulged part with blocks and patches, and a dark surrounding."""
        v, u = np.indices(SIZE[::-1]) / SIZE[0]
        a, b = random.uniform(5, 12, 2)
        depth = (
            450.0 + self.bulge_mm * np.sin(a * u + random.uniform(0, 6)) * np.cos(b * v) + 20.0 * (u - 0.5)
        )
        albedo = np.full(depth.shape, random.uniform(0.6, 0.95))
        for _ in range(6):
            (x, y), (w, h) = random.uniform(0.05, 0.8, 2) * (1, 0.6), random.uniform(0.05, 0.2, 2)
            block = (u > x) & (u < x + w) & (v > y) & (v < y + h)
            depth[block] -= random.uniform(-6, 10)
            albedo[block] *= random.uniform(0.3, 1.0)
        around = (np.abs(u - 0.5) > 0.46) | (np.abs(v - 0.33) > 0.3)
        return depth, np.where(around, 0.03, albedo)

    def _exposed(
        self, k: int, step: int, seen: Floats, albedo: Floats, inside: Floats, random: np.random.Generator,
        elapsed: float,
    ) -> np.ndarray:  # fmt: skip
        fringe = self.plan.fringes[k]
        size = axis_length(PROJECTOR, fringe.axis)
        position = (seen[..., "xy".index(fringe.axis)] + 0.5 + self.drift_px * elapsed) / size
        contrast = np.exp(-2 * (np.pi * self.projector_blur_px * fringe.stripes / size) ** 2)
        wave = 0.5 + 0.5 * contrast * np.cos(TWO_PI * (fringe.stripes * position - step / fringe.images))
        light = self.lamp * inside * (0.01 + 0.99 * wave**self.gamma) * (1 + random.normal(0, self.flicker))
        light *= 1.0 + self.warms * elapsed
        level = (self.white * albedo * (light + self.ambient)).astype(np.float32)
        if self.moves_px:
            du, dv = random.normal(0, self.moves_px, 2)
            shift = np.array([[1, 0, du], [0, 1, dv]], np.float32)
            level = cv2.warpAffine(level, shift, SIZE, borderMode=cv2.BORDER_REPLICATE)
        level = cv2.GaussianBlur(level, (0, 0), self.camera_blur_px).astype(np.float64)
        electrons = random.poisson(self.full_well_e * np.maximum(level, 0)) + random.normal(0, 5, level.shape)
        top = full_scale(self.bits)
        raw = np.rint(top * (electrons / self.full_well_e + 0.005))
        return np.asarray(np.clip(raw, 0, top).astype(raw_dtype(self.bits)))


def with_faults(bench: Bench, *faults: dict[str, object]) -> Bench:
    for fault in faults:
        bench = replace(bench, **fault)  # type: ignore[arg-type]
    return bench
