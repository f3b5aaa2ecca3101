"""Parts that move while they are scanned: what their motion costs, with and without compensation.

Frames are drawn by formulas: a bulged part with patches, which moves evenly, before a table at rest. Errors
are those of the part's points at the middle of the finest set, less those of a part at rest, in squares.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np

from benchmarks import Result, above, below
from fpplab.calibration.model import Calibration
from fpplab.cli import console
from fpplab.core.conventions import AXES, TWO_PI, Floats, Image, Mask, axis_length, full_scale, raw_dtype
from fpplab.core.depth import DepthRange
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.core.progress import no_progress
from fpplab.diagnosis import Diagnosis, diagnose_scan
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.pipeline.measuring import triangulate_recording
from fpplab.reconstruction.motion import compensate_motion
from fpplab.reconstruction.triangulation import camera_slopes

SIZE, PROJECTOR = (320, 240), (912, 1140)
FRINGES = (0.2, 0.5, 1.0, 2.0)  # widths of the finest fringes by which parts move over a scan
DIRECTIONS = {"axial": np.array([0.0, 0.0, 1.0]), "lateral": np.array([1.0, 0.3, 0.0]) / np.hypot(1.0, 0.3)}
FOUR_STEPS = Plan(fringes=tuple(Sinusoid(axis="x", stripes=s, steps=4) for s in (1, 8, 64)))
PLANS = {
    "paper": Plan.load("plan_paper"),
    "scan": Plan.load("plan_scan"),
    "nine": Plan.load("plan_nine_images"),
    "four_steps": FOUR_STEPS,
}
MIN_LATERAL = 1.0  # of a part that goes across: less changes nothing but its edges
FIRST_SEED, STILL = 92_000, 24
MIN_SHARE = 0.7  # of what is measured of a part at rest, of which errors are judged
UNKNOWN_UM = 1e3  # error of a part that becomes no points
TABLE_MM, PART_MM, HALF_MM = 468.0, 452.0, np.array([16.0, 12.0])  # distances of both, half the part's size


@dataclass(frozen=True)
class MovingScene:
    """A part that is displaced by so many mm over a scan, in the camera's frame."""

    plan: Plan
    moved_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    seed: int = 0
    bits: int = 12
    full_well_e: float = 20000.0
    flicker: float = 0.002

    @cached_property
    def rig(self) -> Calibration:
        camera = Pinhole.from_focal(SIZE, (2400.0, 2400.0), (159.0, 121.0), (-0.05, 0.04, 4e-4, 0, 0))
        projector = Pinhole.from_focal(PROJECTOR, (2150.0, 2150.0), (455.0, 570.0), (-0.03, 0.05, 0, 2e-4, 0))
        turn = RigidTransform.from_vectors(np.array([0.02, np.arctan2(150.0, 450.0), 0.01]), np.zeros(3))
        place = np.array([150.0, 8.0, 10.0])
        return Calibration(camera, projector, RigidTransform(turn.rotation, -turn.rotation @ place), {})

    @property
    def middle(self) -> float:
        """When the finest set is half taken, as a share of the scan."""
        finest = self.plan.finest_set(self.plan.axes[0])
        first, end = self.plan.set_starts[finest : finest + 2]
        return 0.5 * (first + end - 1) / (self.plan.images - 1)

    def recording(self) -> Recording:
        random = np.random.default_rng([29, self.seed])
        last = self.plan.images - 1
        frames = list[Image]()
        for n, (k, step, _) in enumerate(self.plan.steps()):
            if n == 0 or any(self.moved_mm):
                points, albedo, _ = self.surface(n / last)
                seen = self.rig.projector.project(points, self.rig.T_projector_camera)
            frames.append(self._exposed(k, step, seen, albedo, random))
        depth = DepthRange((425.0, 475.0), "benchmark") if self.plan.depth_mm else None
        return Recording(frames, self.plan, PROJECTOR, self.bits, "scan", depth=depth)

    def surface(self, when: float) -> tuple[Floats, Floats, Mask]:
        """Points seen (height, width, 3), their albedo, and which are the part's, at a share of the scan."""
        moved = (when - self.middle) * np.array(self.moved_mm)
        slopes = np.stack([*camera_slopes(self.rig.camera), np.ones(SIZE[::-1])], axis=-1)
        shape = np.random.default_rng([31, self.seed])
        waves, starts = shape.uniform(0.12, 0.3, (2, 2)), shape.uniform(0, 6, (2, 2))
        tilt, albedo = shape.uniform(-0.25, 0.25, 2), shape.uniform(0.55, 0.95)
        depth = np.full(SIZE[::-1], PART_MM)
        for _ in range(8):
            at = slopes * depth[..., None] - moved
            bulge = 2.0 * np.sin(waves[0, 0] * at[..., 0] + starts[0, 0]) * np.cos(waves[0, 1] * at[..., 1])
            depth = PART_MM + moved[2] + bulge + at[..., :2] @ tilt
        part = np.all(np.abs(at[..., :2]) < HALF_MM, axis=-1)
        across, down = np.moveaxis(np.sin(2 * waves[1] * at[..., :2] + starts[1]), -1, 0)
        light = albedo * (1.0 + 0.3 * np.tanh(4 * across * down))
        depth = np.where(part, depth, TABLE_MM)
        table = 0.5 + 0.1 * np.sin(0.4 * slopes[..., 0] * TABLE_MM)
        return slopes * depth[..., None], np.where(part, 0.7 * light, table), part

    def _exposed(self, k: int, step: int, seen: Floats, albedo: Floats, random: np.random.Generator) -> Image:
        fringe = self.plan.fringes[k]
        size = axis_length(PROJECTOR, fringe.axis)
        contrast = np.exp(-2 * (np.pi * 0.5 * fringe.stripes / size) ** 2)
        turns = fringe.stripes * (seen[..., AXES.index(fringe.axis)] + 0.5) / size - step / fringe.images
        wave = 0.5 + 0.5 * contrast * np.cos(TWO_PI * turns)
        level = 0.85 * albedo * (0.03 + 0.97 * wave * (1 + random.normal(0, self.flicker)))
        level = cv2.GaussianBlur(level, (0, 0), 0.5)
        electrons = random.poisson(self.full_well_e * level) + random.normal(0, 5, level.shape)
        top = full_scale(self.bits)
        raw = np.clip(np.rint(top * electrons / self.full_well_e), 0, top)
        return np.asarray(raw.astype(raw_dtype(self.bits)))


@dataclass(frozen=True)
class MeasuredPart:
    """What was measured of a part."""

    rms_um: float  # of the distance of its points; infinite where there are none
    stated_um: float  # the same as stated
    share: float  # of its pixels that became points
    told: str  # the verdict's sentence


def measured(scene: MovingScene, recording: Recording) -> MeasuredPart:
    decoded, points = triangulate_recording(recording, scene.rig, None, no_progress)
    if isinstance(points, Diagnosis):
        return MeasuredPart(np.inf, np.inf, 0.0, points.sentence)
    truth, _, part = scene.surface(scene.middle)
    assert points.pixels is not None
    u, v = points.pixels.astype(int).T
    own, off = part[v, u], 1e3 * (points.points[:, 2] - truth[v, u, 2])
    sigmas = [s for s in (points.sigma_noise_mm, points.sigma_phase_error_mm) if s is not None]
    stated = 1e3 * np.sqrt(np.sum(np.square(sigmas), axis=0))[own]
    told = diagnose_scan(recording, decoded, points, scene.rig).sentence
    if not own.any():
        return MeasuredPart(np.inf, np.inf, 0.0, told)
    rms, of_stated = (float(np.sqrt(np.mean(np.square(each)))) for each in (off[own], stated))
    return MeasuredPart(rms, of_stated, float(own.sum() / part.sum()), told)


def period_mm(plan: Plan, direction: Floats) -> float:
    """By how many mm a part goes on by one of the finest fringes."""
    rig, point = MovingScene(plan).rig, np.array([0.0, 0.0, PART_MM])
    ends = point + np.array([[-0.5], [0.5]]) * direction
    seen = rig.projector.project(ends, rig.T_projector_camera)[:, 0]
    stripes = plan.fringes[plan.finest_set("x")].stripes
    return float(PROJECTOR[0] / stripes / abs(seen[1] - seen[0]))


def run() -> list[Result]:
    """Scan parts that move and parts at rest, by several plans; ten minutes on a quiet core."""
    results, told, false = list[Result](), 0, 0
    with console.progress("Motion") as report:
        drawn = [
            (name, fringes, direction)
            for name in PLANS
            for fringes in FRINGES
            for direction in DIRECTIONS
            if direction == "axial" or fringes >= MIN_LATERAL
        ]
        for cases, (name, fringes, direction) in enumerate(drawn):
            seed, plan, way = FIRST_SEED + cases, PLANS[name], DIRECTIONS[direction]
            moved = (1.0 if seed % 2 else -1.0) * fringes * period_mm(plan, way) * way
            scene = MovingScene(plan, (moved[0], moved[1], moved[2]), seed)
            of_case, is_told = _case(f"{name}_{fringes:g}_{direction}", scene)
            results += of_case
            told += is_told
            report((cases + 1) / (len(drawn) + 1))
        for n in range(STILL):
            plan = list(PLANS.values())[n % len(PLANS)]
            scene = MovingScene(plan, seed=FIRST_SEED + 5000 + n, bits=(8, 12)[n % 2])
            recording = scene.recording()
            false += compensate_motion(recording, scene.rig) is not recording
    return [
        *results,
        above("motion_told", float(told), f"of {len(drawn)} scans", float(len(drawn))),
        below("still_scans_compensated", float(false), f"of {STILL} scans", 1e-9),
    ]


def _case(label: str, scene: MovingScene) -> tuple[list[Result], bool]:
    """One part: its error beside that without compensation, both in excess of a part at rest."""
    recording = scene.recording()
    rest = replace(scene, moved_mm=(0.0, 0.0, 0.0))
    still = measured(rest, rest.recording())
    without = measured(scene, recording)
    stilled = compensate_motion(recording, scene.rig)
    compensated = measured(scene, stilled)
    motion = stilled.motion
    is_told = "moved by" in compensated.told
    console.log_status(
        f"{label}: at rest {still.rms_um:.1f} µm ({still.share:.0%}), uncompensated {without.rms_um:.1f} µm "
        f"({without.share:.0%}), compensated {compensated.rms_um:.1f} µm ({compensated.share:.0%}), stated "
        f"{compensated.stated_um:.1f} µm; {compensated.told}"
    )
    if motion is None or not all(part.is_compensated for part in motion.parts):
        return [above(f"{label}_told", float(is_told), "", 1.0)], is_told
    excess = float(np.sqrt(max(compensated.rms_um**2 - still.rms_um**2, 0.0)))
    uncompensated = min(without.rms_um, UNKNOWN_UM)
    results = [
        below(f"{label}_error", excess, "um", uncompensated / 5.0),
        below(f"{label}_error_over_stated", compensated.rms_um / compensated.stated_um, "ratio", 1.5),
        above(f"{label}_measured", compensated.share, "of the part", MIN_SHARE * still.share),
    ]
    return results, is_told
