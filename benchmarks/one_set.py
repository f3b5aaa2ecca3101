"""One set of fringes, and one frame: spread beside its bound, islands, orders, heights over a plane, speed.

Frames are made by formula with a blur and noise. A step that lies within noise of whole periods along a part
of an edge is invisible in one set; those trials are counted by themselves.
"""

import time
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter
from skimage.restoration import unwrap_phase

from benchmarks import Result, above, below
from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.conventions import Floats, Mask
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.phase.bounds import PossibleCoordinates
from fpplab.phase.islands import find_islands
from fpplab.phase.reference_plane import PlaneGeometry
from fpplab.pipeline.heights import decode_heights, plane_of
from fpplab.reconstruction.points import triangulate

SIZE, BITS, BLUR_PX = (912, 1140), 12, 0.7
MODULATION, NOISE = 60.0, 1.0  # grey levels
WITHIN = 1.2  # spread over its bound
STRIPES = {4: 40.0, 3: 40.0, 1: 100.0}  # by the images of the set
TRIALS, REPEATS = 60, 6
INVISIBLE_RAD = {4: 0.12, 3: 0.12, 1: 0.4}  # a step that is nearer to whole periods, by the images of a set,
INVISIBLE_PX = 25  # along so much of an edge
FIRST_SEED = 47_000
Y, X = np.mgrid[:240, :320].astype(float)


def run() -> list[Result]:
    """Measure spread, islands, orders and heights; two minutes on a quiet core."""
    results = []
    for images in STRIPES:
        for shape in ("step", "sphere", "free"):
            results += _spread(images, shape)
        results += _islands(images)
    return [*results, *_orders(), *_heights(), _speed()]


def _plan(images: int) -> Plan:
    fringes: dict[str, Any] = {"axis": "x", "stripes": STRIPES[images], "steps": images}
    if images == 1:
        fringes = {"kind": "shifted", "axis": "x", "stripes": STRIPES[1], "shifts_deg": [0]}
    return config.validate({"fringes": [fringes], "unwrapping": "spatial"}, Plan, "benchmark")


def _period(images: int) -> float:
    return SIZE[0] / STRIPES[images]


def _recorded(coordinate: Floats, images: int, random: np.random.Generator, blur_px: float) -> Recording:
    plan, frames = _plan(images), []
    for step in range(images):
        level = 40.0 + 2.0 * MODULATION * plan.sets[0].light(step, coordinate, SIZE[0])
        level = gaussian_filter(level, blur_px) + random.normal(0.0, NOISE, level.shape)
        frames.append(np.rint(np.clip(level, 0, 255) * (2**BITS - 1) / 255).astype(np.uint16))
    return Recording(frames, plan, SIZE, bits=BITS)


def _shape(name: str, images: int, random: np.random.Generator) -> Floats:
    flat = random.uniform(50, 150) + random.uniform(0.9, 1.3) * X + random.uniform(-0.2, 0.2) * Y
    if name == "step":
        return np.asarray(flat + np.where(_plate(), random.uniform(0.15, 0.85) * _period(images), 0.0))
    if name == "sphere":
        radius = random.uniform(70, 100)
        height = np.sqrt(np.maximum(radius**2 - (X - 160) ** 2 - (Y - 120) ** 2, 0.0))
        return np.asarray(flat + random.uniform(0.05, 0.2) * height)
    wide, tall = random.uniform(25, 50, 2)
    return np.asarray(flat + random.uniform(2, 6) * np.sin(X / wide) * np.cos(Y / tall))


def _plate() -> Mask:
    return np.asarray((X > 90) & (X < 230) & (Y > 60) & (Y < 180))


def _errors(decoded: Decoded, truth: Floats, period: float) -> tuple[Floats, int]:
    """Errors within islands, and pixels that are another number of periods off than most of their island."""
    island, error, wrong = decoded.island, decoded.u - truth, 0
    assert island is not None
    for number in np.unique(island[island != 0]):
        own = island == number
        orders = np.rint(error[own] / period)
        wrong += int(np.count_nonzero(orders != np.median(orders)))
        error[own] -= np.median(orders) * period
    return error, wrong


def _spread(images: int, shape: str) -> list[Result]:
    """Scatter of repeated frames in islands beside Cramér and Rao's bound, for one frame by its bandwidth."""
    random, period = np.random.default_rng(FIRST_SEED + 10 * images + len(shape)), _period(images)
    truth = _shape(shape, images, random)
    maps = [decode(_recorded(truth, images, random, 0.0)) for _ in range(REPEATS)]
    errors = np.array([_errors(each, truth, period)[0] for each in maps])
    errors[np.abs(errors) > 0.5 * period] = np.nan
    known = np.isfinite(errors).all(axis=0)
    scatter = float(np.sqrt(np.mean(np.var(errors[:, known], axis=0, ddof=1))))
    bound = np.sqrt(2.0 / images) * NOISE / MODULATION * period / (2.0 * np.pi)
    if images == 1:
        window = 0.5 * (maps[0].resolution_px or np.nan)
        bound *= np.sqrt(11.0 / 6.0 / (4.0 * np.pi)) / window
    stated = float(np.sqrt(np.mean(np.square(maps[0].sigma[known]))))
    label = f"{shape}_of_{images}"
    return [
        below(f"spread_{label}", scatter, "px", WITHIN * bound),
        below(f"spread_over_stated_{label}", scatter / stated, "", WITHIN),
        above(f"measured_{label}", float(known.mean()), "", 0.4 if images == 1 else 0.8),
    ]


def _islands(images: int) -> list[Result]:
    """Plates over a plane, by any step that changes along the edges: pixels of a wrong relative order."""
    period, wrong, invisible, parted = _period(images), 0, 0, 0
    for trial in range(TRIALS):
        random = np.random.default_rng(FIRST_SEED + 1000 * (1 + images) + trial)
        step = random.uniform(0.1, 4.0) + random.uniform(-0.5, 0.5) * (Y - 120) / 60
        truth = _shape("free", images, random) + np.where(_plate(), step * period, 0.0)
        decoded = decode(_recorded(truth, images, random, BLUR_PX))
        off = _errors(decoded, truth, period)[1]
        if _is_invisible(step, INVISIBLE_RAD[images]):
            invisible += off > 0
        else:
            wrong += off
            parted += 1
    return [
        below(f"pixels_of_wrong_order_in_islands_of_{images}", float(wrong), "", 1e-9),
        above(f"visible_steps_of_{images}", float(parted), "", 1.0),
        below(f"invisible_steps_joined_of_{images}", float(invisible), "", float(TRIALS - parted)),
    ]


def _is_invisible(step: Floats, within_rad: float) -> bool:
    """Whether a part of the plate's edge lies within noise of whole periods, but for none."""
    for edge in (step[60:181, 90], step[61, 90:231], step[179, 90:231]):
        near = (2.0 * np.pi * np.abs(edge - np.rint(edge)) < within_rad) & (np.rint(edge) != 0)
        if near.sum() >= INVISIBLE_PX:
            return True
    return False


def _orders() -> list[Result]:
    """Islands that a range of coordinates places: never at a wrong order."""
    period, wrong, known = _period(4), 0, 0
    for trial in range(TRIALS):
        random = np.random.default_rng(FIRST_SEED + 9000 + trial)
        truth = _shape("step", 4, random)
        low, high = random.uniform(0.1, 1.2, 2) * period
        possible = PossibleCoordinates((truth - low).astype(np.float32), (truth + high).astype(np.float32))
        decoded = decode(_recorded(truth, 4, random, BLUR_PX), bounds={"x": possible}).of_known_order()
        wrong += int(np.count_nonzero(np.abs(decoded.u - truth) > 0.5 * period))
        known += bool(decoded.valid.any())
    return [
        below("pixels_placed_wrongly", float(wrong), "", 1e-9),
        above("trials_placed", float(known), "", 1.0),
    ]


def _heights() -> list[Result]:
    """Heights over a plane beside those that the calibration triangulates, by four steps and one frame."""
    camera = Pinhole.from_focal((320, 240), (600.0, 600.0), (159.5, 119.5))
    projector = Pinhole.from_focal(SIZE, (1100.0, 1100.0), (730.5, 569.5))
    pose = RigidTransform.from_vectors(np.zeros(3), np.array([-100.0, 0.0, 0.0]))
    rig, results = Calibration(camera, projector, pose, {}), []
    slopes = camera.normalise(np.stack([X, Y], axis=-1))
    rays = np.concatenate([slopes, np.ones((*X.shape, 1))], axis=-1)
    for images in (4, 1):
        random = np.random.default_rng(FIRST_SEED + 9900 + images)
        dome = 3.0 + 8.0 * np.exp(-((X - 160) ** 2 + (Y - 120) ** 2) / random.uniform(50, 70) ** 2)
        stated = {"distance_mm": 400.0, "baseline_mm": -100.0, "period_mm": _period(images) * 400.0 / 1100.0}
        geometry = config.validate(stated, PlaneGeometry, "benchmark")
        recordings = [
            _recorded(
                projector.project((400.0 - height) * rays, rig.T_projector_camera)[..., 0],
                images,
                random,
                0.0,
            )
            for height in (np.zeros((*X.shape, 1)), dome[..., None])
        ]
        plane = plane_of(recordings[0], geometry, [])
        decoded = decode_heights(recordings[1], plane, ((160, 120, float(dome[120, 160])),))
        assert decoded.height_mm is not None
        # The plane's order moves coordinates of both by whole periods, which triangulation does not forgive.
        known = np.isfinite(decoded.height_mm)
        triangulated = triangulate(_at_true_order(decoded, recordings[1], dome, rig, images), rig)
        assert triangulated.pixels is not None
        column, row = triangulated.pixels.T
        height = decoded.height_mm[row, column]
        relative = np.abs(np.nanmean(height / (400.0 - triangulated.points[:, 2]) - 1.0))
        results.append(below(f"heights_off_triangulated_of_{images}", float(relative), "", 0.01))
        results.append(above(f"heights_measured_of_{images}", float(known.mean()), "", 0.6))
    return results


def _at_true_order(
    decoded: Decoded, recording: Recording, dome: Floats, rig: Calibration, images: int
) -> Decoded:
    slopes = rig.camera.normalise(np.stack([X, Y], axis=-1))
    points = (400.0 - dome[..., None]) * np.concatenate([slopes, np.ones((*X.shape, 1))], axis=-1)
    truth = rig.projector.project(points, rig.T_projector_camera)[..., 0]
    off = np.rint(np.nanmedian(decoded.u - truth) / _period(images)) * _period(images)
    shift = PossibleCoordinates((truth - 2).astype(np.float32), (truth + 2).astype(np.float32))
    return decode(recording, bounds={"x": shift}) if off else decoded


def _speed() -> Result:
    """Time the islands of a megapixel beside the reliability-guided unwrapping of scikit-image."""
    random = np.random.default_rng(FIRST_SEED)
    v, u = np.mgrid[:1000, :1000].astype(float)
    phase = (0.4 * u + 3.0 * np.sin(v / 60.0) + random.normal(0, 0.02, u.shape)) % (2.0 * np.pi)
    sigma, usable = np.full(u.shape, 0.02), np.ones(u.shape, np.bool_)
    find_islands(phase, sigma, usable)  # compiles
    begin = time.process_time()
    find_islands(phase, sigma, usable)
    product = time.process_time() - begin
    begin = time.process_time()
    unwrap_phase(phase - np.pi)  # type: ignore[no-untyped-call]
    return below("seconds_of_islands", product, "s", time.process_time() - begin)
