"""Frames that something has changed between sensor and decoder: whether σ holds, and what is called good.

A part by formulas is seen by two pinholes, so that every pixel's true coordinate is known. Its frames are
damaged in one way at a time. σ is compared with the errors that decoding really makes, and a scan must not be
called good where the errors exceed the interval of 95 % that it states.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from benchmarks import Result, above, below
from fpplab.calibration.model import Calibration
from fpplab.core.conventions import TWO_PI, Axis, Floats, Image, Mask
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.diagnosis.verdict import diagnose_scan
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.reconstruction.points import triangulate
from fpplab.reconstruction.triangulation import camera_slopes

JUDGING_SEED = 8200
"""The first seed of those that nothing was developed with."""
COUNT = 6
"""Benches of each fault."""
SIZE, PROJECTOR = (512, 384), (912, 1140)
AXIS_LENGTHS = {"x": PROJECTOR[0], "y": PROJECTOR[1]}
NEAR_EDGE_PX = 5
"""Pixels this near to a jump of depth see two surfaces, and are not judged."""
COVERAGE = 1.96
"""Half of the interval of 95 %, in σ."""

Frames = list[Image]
Damage = Callable[[Frames, np.random.Generator], Frames]


@dataclass(frozen=True, eq=False)
class KnownScene:
    """A part, the true coordinates of its pixels, and frames of it without a fault."""

    plan: Plan
    calibration: Calibration
    seen: Floats  # (height, width, 2) true projector coordinates in px
    judged: Mask  # (height, width) pixels that see one surface, and the fringes
    frames: Frames


def drawn_scene(seed: int, step_counts: Sequence[int] = (4, 5, 6, 8, 12)) -> KnownScene:
    """Draw a bench, a part and a plan."""
    random = np.random.default_rng([43, seed])
    calibration = _drawn_rig(random)
    steps = [int(random.choice(step_counts)) for _ in range(2)]
    finest = float(random.choice([48, 64, 80]))
    axes: tuple[Axis, ...] = ("x", "y") if random.random() < 0.5 else ("x",)
    plan = Plan(
        fringes=tuple(
            Sinusoid(axis=axis, stripes=stripes, steps=n)
            for axis in axes
            for stripes, n in ((1, steps[0]), (8, steps[0]), (finest, steps[1]))
        )
    )
    depth, albedo, jumps = _drawn_part(random)
    points = np.stack([*(s * depth for s in camera_slopes(calibration.camera)), depth], axis=-1)
    seen = calibration.projector.project(points, calibration.T_projector_camera)
    lit = np.all((seen > -0.5) & (seen < np.array(PROJECTOR) - 0.5), axis=-1)
    electrons, white, blur = random.uniform(8e3, 3e4), random.uniform(0.6, 0.9), random.uniform(0.4, 0.7)
    frames = []
    for k, step, _ in plan.steps():
        fringe = plan.fringes[k]
        position = (seen[..., "xy".index(fringe.axis)] + 0.5) / AXIS_LENGTHS[fringe.axis]
        wave = 0.5 + 0.42 * np.cos(TWO_PI * (fringe.stripes * position - step / fringe.images))
        level = white * albedo * (wave * lit + 0.02) * (1.0 + random.normal(0, 0.001))
        level = cv2.GaussianBlur(level, (0, 0), blur)
        counted = random.poisson(electrons * level) + random.normal(0, 5.0, level.shape)
        frames.append(np.clip(np.rint(255.0 * (counted / electrons + 0.01)), 0, 255).astype(np.uint8))
    judged = lit & ~jumps & (albedo > 0.1)
    return KnownScene(plan, calibration, seen, np.asarray(judged), frames)


def _drawn_rig(random: np.random.Generator) -> Calibration:
    focal, baseline = SIZE[0] / 169.0 * 450.0, float(random.uniform(120, 180))
    camera = Pinhole.from_focal(SIZE, (focal, focal), (SIZE[0] / 2, SIZE[1] / 2), (-0.1, 0.08, 4e-4, 0, 0))
    projector = Pinhole.from_focal(PROJECTOR, (2150.0, 2150.0), (455.0, 570.0), (-0.03, 0.05, 0, 2e-4, 0))
    turn = RigidTransform.from_vectors(np.array([0.02, np.arctan2(baseline, 450.0), 0.01]), np.zeros(3))
    place = np.array([baseline, 8.0, 10.0])
    return Calibration(camera, projector, RigidTransform(turn.rotation, -turn.rotation @ place), {})


def _drawn_part(random: np.random.Generator) -> tuple[Floats, Floats, Mask]:
    """Depth in mm, reflectance, and the pixels near jumps: a bulge with blocks, print and grain."""
    v, u = np.indices(SIZE[::-1]) / SIZE[0]
    a, b = random.uniform(5, 12, 2)
    depth = 450.0 + 8.0 * np.sin(a * u + random.uniform(0, 6)) * np.cos(b * v) + 20.0 * (u - 0.5)
    albedo = np.full(depth.shape, random.uniform(0.6, 0.95))
    jumps = np.zeros(depth.shape, np.uint8)
    for _ in range(5):
        (x, y), (w, h) = random.uniform(0.05, 0.8, 2) * (1, 0.6), random.uniform(0.05, 0.2, 2)
        block = (u > x) & (u < x + w) & (v > y) & (v < y + h)
        depth[block] -= random.uniform(-6, 10)
        outline = cv2.morphologyEx(block.astype(np.uint8), cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
        jumps = np.maximum(jumps, outline.astype(np.uint8))
        (x, y), (w, h) = random.uniform(0.05, 0.8, 2) * (1, 0.6), random.uniform(0.02, 0.1, 2)
        albedo[(u > x) & (u < x + w) & (v > y) & (v < y + h)] *= random.uniform(0.4, 1.0)
    grain = cv2.GaussianBlur(random.normal(0, 1, depth.shape), (0, 0), random.uniform(0.8, 2.5))
    albedo *= np.clip(1.0 + random.uniform(0.01, 0.06) * grain / grain.std(), 0.3, 1.05)
    around = (np.abs(u - 0.5) > 0.47) | (np.abs(v - 0.375) > 0.35)
    near = cv2.dilate(jumps, np.ones((2 * NEAR_EDGE_PX + 1,) * 2, np.uint8)) > 0
    inner = cv2.erode((~around).astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    return depth, np.where(around, 0.03, albedo), near | ~inner


def _each(change: Callable[[Image], Any]) -> Damage:
    return lambda frames, _: [_levels(change(frame)) for frame in frames]


def _levels(values: Any) -> Image:
    levels: Image = np.clip(np.rint(values), 0, 255).astype(np.uint8)
    return levels


def _coded(kind: str, option: int, quality: int, frame: Image) -> Image:
    _, data = cv2.imencode(kind, frame, [option, quality])
    return _levels(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE))


def jpeg(quality: int) -> Damage:
    """Compress and open again."""
    return _each(lambda frame: _coded(".jpg", cv2.IMWRITE_JPEG_QUALITY, quality, frame))


def _webp(frames: Frames, random: np.random.Generator) -> Frames:
    quality = int(random.integers(60, 96))
    return [_coded(".webp", cv2.IMWRITE_WEBP_QUALITY, quality, frame) for frame in frames]


def _sharpened(frames: Frames, random: np.random.Generator) -> Frames:
    amount, radius = random.uniform(0.5, 1.5), random.uniform(0.8, 2.0)
    floats = [frame.astype(np.float32) for frame in frames]
    return [_levels(f + amount * (f - cv2.GaussianBlur(f, (0, 0), radius))) for f in floats]


def gaussian(frames: Frames, random: np.random.Generator) -> Frames:
    """Denoise by a Gaussian."""
    width = random.uniform(0.8, 1.6)
    return [_levels(cv2.GaussianBlur(frame.astype(np.float32), (0, 0), width)) for frame in frames]


def _lagging(share: float | None = None) -> Damage:
    def damage(frames: Frames, random: np.random.Generator) -> Frames:
        lag = share or random.uniform(0.02, 0.1)
        before = [frames[0], *frames[:-1]]
        return [_levels((1 - lag) * f + lag * b) for f, b in zip(frames, before, strict=True)]

    return damage


def _stale_rows(frames: Frames, random: np.random.Generator) -> Frames:
    result = [frame.copy() for frame in frames]
    for k in range(1, len(frames)):
        if random.random() < 0.5:
            first = int(random.integers(0, SIZE[1] - 60))
            rows = slice(first, first + int(random.integers(20, 60)))
            result[k][rows] = frames[k - 1][rows]
    return result


def _interchanged_rows(frames: Frames, _: np.random.Generator) -> Frames:
    order = np.arange(SIZE[1]).reshape(-1, 2)[:, ::-1].ravel()
    return [_levels(frame[order]) for frame in frames]


def _four_bits(frames: Frames, _: np.random.Generator) -> Frames:
    return [(frame // 16 * 16).astype(np.uint8) for frame in frames]


def _flicker(frames: Frames, random: np.random.Generator) -> Frames:
    return [_levels(frame * (1 + random.normal(0, 0.015))) for frame in frames]


def _droplet(frames: Frames, random: np.random.Generator) -> Frames:
    """A drop on the front lens: it bends the rays of a part of the image, and blurs them."""
    v, u = np.indices(SIZE[::-1]).astype(np.float32)
    centre, radius = random.uniform(0.35, 0.65, 2) * SIZE, random.uniform(40, 80)
    strength = random.uniform(2.0, 5.0)
    x, y = u - centre[0], v - centre[1]
    weight = np.exp(-(((x**2 + y**2) / radius**2) ** 2)).astype(np.float32)
    shift = (strength * weight * x / radius, strength * weight * y / radius)
    result = []
    for frame in frames:
        bent = cv2.remap(frame.astype(np.float32), u + shift[0], v + shift[1], cv2.INTER_LINEAR)
        result.append(_levels(bent + weight * (cv2.GaussianBlur(bent, (0, 0), strength) - bent)))
    return result


def _smear(frames: Frames, random: np.random.Generator) -> Frames:
    """Grease on the lens: a veil of light from beside, in a part of the image, to one side."""
    v, u = np.indices(SIZE[::-1]).astype(np.float32)
    centre, radius = random.uniform(0.35, 0.65, 2) * SIZE, random.uniform(60, 120)
    weight = 0.4 * np.exp(-((u - centre[0]) ** 2 + (v - centre[1]) ** 2) / radius**2)
    kernel = np.zeros((1, 61), np.float32)
    kernel[0, 30:] = 1 / 31
    return [_levels(f + weight * (cv2.filter2D(f.astype(np.float32), -1, kernel) - f)) for f in frames]


def _dead_columns(frames: Frames, random: np.random.Generator) -> Frames:
    dead, level = random.choice(SIZE[0], 8, replace=False), random.integers(0, 255, 8)
    result = [frame.copy() for frame in frames]
    for frame in result:
        frame[:, dead] = level
    return result


def _uneven_pixels(frames: Frames, random: np.random.Generator) -> Frames:
    gain = 1.0 + random.normal(0, 0.02, SIZE[::-1])
    return [_levels(frame * gain) for frame in frames]


def _row_noise(frames: Frames, random: np.random.Generator) -> Frames:
    return [_levels(frame + random.normal(0, 1.5, (SIZE[1], 1))) for frame in frames]


def _rolling_offset(frames: Frames, random: np.random.Generator) -> Frames:
    rows = np.linspace(0, TWO_PI, SIZE[1])[:, None]
    return [_levels(f + 1.5 + 1.5 * np.sin(rows * 2 + random.uniform(0, TWO_PI))) for f in frames]


def _hot_pixels(frames: Frames, random: np.random.Generator) -> Frames:
    hot = random.random(SIZE[::-1]) < 0.01
    added = np.where(hot, random.uniform(5, 60, SIZE[::-1]), 0.0)
    return [_levels(frame + random.normal(1.0, 0.3, SIZE[::-1]) * added) for frame in frames]


def _moire(frames: Frames, _: np.random.Generator) -> Frames:
    small = (int(SIZE[0] * 0.87), int(SIZE[1] * 0.87))
    return [_levels(cv2.resize(cv2.resize(f, small, interpolation=cv2.INTER_NEAREST), SIZE)) for f in frames]


def _stuck_bit(frames: Frames, random: np.random.Generator) -> Frames:
    bit = np.uint8(1 << int(random.integers(2, 5)))
    return [_levels(frame | bit) for frame in frames]


def _duplicated_frame(frames: Frames, random: np.random.Generator) -> Frames:
    k = int(random.integers(1, len(frames)))
    return [*frames[:k], frames[k - 1], *frames[k + 1 :]]


def _exchanged_halves(frames: Frames, _: np.random.Generator) -> Frames:
    half = SIZE[0] // 2
    return [_levels(np.roll(frame, half, axis=1)) for frame in frames]


def _camera_gamma(frames: Frames, random: np.random.Generator) -> Frames:
    exponent = random.uniform(0.5, 0.8)
    return [_levels(255.0 * (frame / 255.0) ** exponent) for frame in frames]


def _drawn_jpeg(frames: Frames, random: np.random.Generator) -> Frames:
    return jpeg(int(random.integers(60, 96)))(frames, random)


def _median(frames: Frames, random: np.random.Generator) -> Frames:
    size = int(random.choice([3, 5]))
    return [_levels(cv2.medianBlur(frame, size)) for frame in frames]


def _bilateral(frames: Frames, random: np.random.Generator) -> Frames:
    level = random.uniform(8, 25)
    return [_levels(cv2.bilateralFilter(frame, 5, level, 2.0)) for frame in frames]


def _non_local(frames: Frames, _: np.random.Generator) -> Frames:
    return [_levels(cv2.fastNlMeansDenoising(frame, None, 4.0, 5, 11)) for frame in frames]


SIGMA_JUDGED: dict[str, Damage] = {
    "healthy": lambda frames, _: frames,
    "jpeg": _drawn_jpeg,
    "gaussian": gaussian,
    "median": _median,
    "bilateral": _bilateral,
    "non_local": _non_local,
    "sharpened": _sharpened,
    "lag": _lagging(),
}
"""Whose σ must be that of the errors."""
OTHERS: dict[str, Damage] = {
    "jpeg_15": jpeg(15),
    "stale_rows": _stale_rows,
    "interchanged_rows": _interchanged_rows,
    "four_bits": _four_bits,
    "flicker": _flicker,
    "droplet": _droplet,
    "smear": _smear,
    "dead_columns": _dead_columns,
    "uneven_pixels": _uneven_pixels,
    "webp": _webp,
    "row_noise": _row_noise,
    "rolling_offset": _rolling_offset,
    "hot_pixels": _hot_pixels,
    "moire": _moire,
    "stuck_bit": _stuck_bit,
    "duplicated_frame": _duplicated_frame,
    "exchanged_halves": _exchanged_halves,
    "camera_gamma": _camera_gamma,
}
"""Which must not be called good beyond the interval."""
OF_THREE_STEPS = "_of_three_steps"
"""What faults are called whose frames show no residuals."""


@dataclass(frozen=True)
class JudgedFrames:
    """One fault on one bench."""

    fault: str
    seed: int
    ratio: float  # of stated to actual errors
    actual_px: float  # RMS error
    valid: float  # share of the judged pixels that are measured
    verdict: str
    causes: tuple[str, ...]
    reason: str

    @property
    def is_sigma_judged(self) -> bool:
        """Whether its σ must be that of the errors."""
        return self.fault.removesuffix(OF_THREE_STEPS) in SIGMA_JUDGED

    @property
    def is_believed_wrong(self) -> bool:
        """Whether it is called good, and its errors exceed the interval."""
        return self.verdict == "good" and COVERAGE * self.ratio < 1.0


def judged_frames(fault: str, seed: int) -> JudgedFrames:
    """Damage the frames of a bench, and judge what is said of them."""
    scene = drawn_scene(seed, (3,)) if fault.endswith(OF_THREE_STEPS) else drawn_scene(seed)
    damage = {**SIGMA_JUDGED, **OTHERS}[fault.removesuffix(OF_THREE_STEPS)]
    return judged_as_said(scene, fault, seed, damage(scene.frames, np.random.default_rng([44, seed])))


def judged_as_said(scene: KnownScene, fault: str, seed: int, frames: Sequence[Image]) -> JudgedFrames:
    """Decode frames, and compare σ and verdict with the errors."""
    recording = Recording(list(frames), scene.plan, PROJECTOR, 8, fault)
    decoded = decode(recording)
    if not (scene.judged & decoded.valid).any():
        return JudgedFrames(fault, seed, np.inf, 0.0, 0.0, "useless", (), "there are no points")
    cloud = triangulate(decoded, scene.calibration)
    said = diagnose_scan(recording, decoded, cloud, scene.calibration)
    stated, actual = stated_and_actual(scene, decoded)
    causes = tuple(finding.cause.key for finding in said.findings)
    valid = (scene.judged & decoded.valid).sum() / scene.judged.sum()
    return JudgedFrames(fault, seed, stated / actual, actual, valid, said.verdict.value, causes, said.reason)


def stated_and_actual(scene: KnownScene, decoded: Decoded) -> tuple[float, float]:
    """RMS of the stated σ of u, and of its errors, in px."""
    used = scene.judged & decoded.valid
    error, sigma = (decoded.u - scene.seen[..., 0])[used], decoded.sigma_total[used]
    return float(np.sqrt(np.mean(np.square(sigma)))), float(np.sqrt(np.mean(np.square(error))))


def run() -> list[Result]:
    """Judge all faults on fresh benches; some minutes."""
    faults = (*SIGMA_JUDGED, *(fault + OF_THREE_STEPS for fault in SIGMA_JUDGED), *OTHERS)
    return frame_figures([judged_frames(f, JUDGING_SEED + k) for f in faults for k in range(COUNT)])


def frame_figures(judged: Sequence[JudgedFrames]) -> list[Result]:
    """Sum up by fault."""
    results = []
    for fault in dict.fromkeys(one.fault for one in judged):
        own = [one for one in judged if one.fault == fault]
        believed = sum(one.is_believed_wrong for one in own)
        results.append(below(f"image_faults_{fault}_believed_wrong", float(believed), "", 0.0))
        if own[0].is_sigma_judged:
            ratios = [one.ratio for one in own]
            results.append(above(f"image_faults_{fault}_least_stated_over_actual", min(ratios), "", 0.8))
            results.append(below(f"image_faults_{fault}_greatest_stated_over_actual", max(ratios), "", 1.25))
    return results
