"""Codes of other kinds than fringes: spread beside its bound, chance of error, orders, and speed.

Frames are made by the codes' formulas from known coordinates, with a Gaussian blur and noise.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter1d

from benchmarks import Result, above, below
from fpplab.core import config
from fpplab.core.conventions import Floats, Lattice
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.phase.bounds import PossibleCoordinates
from fpplab.phase.code_decoding import decode_codes
from fpplab.phase.code_table import code_table
from fpplab.phase.coded_axes import sets_of_axis

SIZE, SHAPE = (912, 1140), (200, 400)
FULL_SHAPE = (500, 800)  # for times, of which some do not grow with the image
REACH_PX = 40.0  # what a calibration and a range of depths leave possible, to either side
MODULATION, DARK, BLUR_PX, BITS = 60.0, 30.0, 0.7, 12
RATIOS = (10.0, 20.0, 50.0)  # modulation over noise
WITHIN = 1.1  # spread over its bound
EVEN: dict[str, Any] = {"kind": "even", "levels": [1, 0]}
MICRO_STRIPES = (
    40.3,
    34.8,
    47.4,
    30.8,
    36.4,
    50.1,
    36.0,
)  # drawn, of which the nearest codes are farthest apart
FEW = slice(0, 5)  # of its sets, which noise confuses
STRIPE_IMAGES, STRIPES_PX = 12, (3, 7)  # pattern files of random stripes, and least and greatest width


def _micro(stripes: tuple[float, ...]) -> list[dict[str, Any]]:
    shifts = [[0, 120, 240], *([0] for _ in stripes[1:])]
    return [
        {"kind": "shifted", "axis": "x", "stripes": count, "shifts_deg": angles}
        for count, angles in zip(stripes, shifts, strict=True)
    ]


CODES = {
    "gray_12_images": [EVEN, {"kind": "gray", "axis": "x", "bits": 10}],
    "gray_with_inverses": [{"kind": "gray", "axis": "x", "bits": 10, "inverses": "each"}],
    "micro_9_images": _micro(MICRO_STRIPES),
}


def run() -> list[Result]:
    """Measure every code at several levels of noise; a minute on a quiet core."""
    results = []
    codes = {**CODES, f"stripes_of_{STRIPE_IMAGES}_files": _random_stripes()}
    for seed, (name, sets) in enumerate(codes.items(), start=39_000):
        for ratio in RATIOS:
            results += _spread(name, sets, ratio, seed)
    return [*results, *_chance_of_error(), *_orders(), *_speed(), *_five_megapixels()]


def _random_stripes() -> list[dict[str, Any]]:
    """A plan's set of pattern files, each of stripes of random widths and levels."""
    random, names = np.random.default_rng(39_600), [f"{k}.png" for k in range(STRIPE_IMAGES)]
    with TemporaryDirectory(prefix="fpplab-bench-") as folder:
        for name in names:
            widths = random.integers(*STRIPES_PX, SIZE[0], endpoint=True)
            stripes = np.repeat(random.integers(0, 256, SIZE[0], np.uint8), widths)[: SIZE[0]]
            cv2.imwrite(f"{folder}/{name}", np.tile(stripes, (SIZE[1], 1)))
        plan = Path(folder) / "plan.yaml"
        plan.write_text(config.to_yaml({"fringes": [{"kind": "files", "axis": "x", "names": names}]}))
        return list(config.parse_yaml(config.dump(Plan.load(plan)), "plan")["fringes"])


def _light(plan: Plan, coordinate: Floats) -> Floats:
    """What every image shows at coordinates, (K, ...)."""
    fine = np.arange(-8 + 1 / 64, SIZE[0] + 8, 1 / 32)
    shown = (each.light(step, fine, SIZE[0]) for each in plan.sets for step in range(each.images))
    blurred = (gaussian_filter1d(light, 32 * BLUR_PX, mode="nearest") for light in shown)
    return np.array([np.interp(coordinate, fine, light) for light in blurred])


def _recorded(
    sets: list[dict[str, Any]],
    ratio: float,
    seed: int,
    shape: tuple[int, int] = SHAPE,
    *,
    smooth: bool = False,
) -> tuple[Floats, Recording]:
    plan = config.validate({"fringes": sets}, Plan, "benchmark")
    random = np.random.default_rng(seed)
    coordinate = random.uniform(6, SIZE[0] - 7, shape)
    if smooth:
        coordinate = np.sort(coordinate, axis=1)
    levels = DARK + 2 * MODULATION * _light(plan, coordinate)
    levels += random.normal(0, MODULATION / ratio, levels.shape)
    full = 2**BITS - 1
    frames = np.rint(np.clip(levels, 0, 255) * full / 255).astype(np.uint16)
    return coordinate, Recording(list(frames), plan, SIZE, bits=BITS)


def _bound(plan: Plan, coordinate: Floats, ratio: float) -> Floats:
    """Cramér and Rao's bound where offset and modulation are unknown, in px."""
    step = 0.05
    slope = (_light(plan, coordinate + step) - _light(plan, coordinate - step)) / (2 * step)
    light = _light(plan, coordinate)
    slope, light = slope - slope.mean(axis=0), light - light.mean(axis=0)
    unit = light / np.linalg.norm(light, axis=0)
    slope -= np.sum(slope * unit, axis=0) * unit
    return np.asarray(1.0 / (2.0 * ratio * np.linalg.norm(slope, axis=0)))


def _spread(name: str, sets: list[dict[str, Any]], ratio: float, seed: int) -> list[Result]:
    coordinate, recording = _recorded(sets, ratio, seed)
    decoded = decode(recording)
    error = (decoded.u - coordinate)[decoded.valid]
    bound = _bound(recording.plan, coordinate, ratio)[decoded.valid]
    spread, limit = (float(np.sqrt(np.mean(part**2))) for part in (error, bound))
    stated = float(np.sqrt(np.mean((error / decoded.sigma[decoded.valid]) ** 2)))
    label = f"{name}_at_{ratio:g}"
    return [
        below(f"spread_{label}", spread, "px", WITHIN * limit),
        below(f"error_over_stated_{label}", stated, "", WITHIN),
        above(f"measured_{label}", float(decoded.valid.mean()), "", 0.95),
    ]


def _chance_of_error() -> list[Result]:
    """Compare the stated chance of another coordinate with how often it is another one."""
    coordinate, recording = _recorded(_micro(MICRO_STRIPES)[FEW], RATIOS[0], 39_100)
    coded = decode_codes(recording, "x", sets_of_axis(recording.plan, "x", with_fringes=True))
    wrong = float(np.mean(np.abs(coded.coordinate - coordinate) > 3.0))
    stated = float(np.mean(1.0 / (1.0 + np.exp(0.5 * np.minimum(coded.gap, 200.0)))))
    return [
        below("chance_of_error_stated", stated, "", 2.0 * wrong),
        above("chance_of_error_stated_at_least", stated, "", 0.5 * wrong),
    ]


def _orders() -> list[Result]:
    """Give fringes their orders by Gray cells of a period and of half a period."""
    results = []
    for name, cell_px, bits in (("period", 16.0, 6), ("half_period", 8.0, 7)):
        gray = {"kind": "gray", "axis": "x", "bits": bits, "cell_px": cell_px}
        sets = [EVEN, gray, {"axis": "x", "stripes": 57.0, "steps": 4}]
        coordinate, recording = _recorded(sets, RATIOS[1], 39_200 + bits)
        decoded = decode(recording)
        wrong = np.abs(decoded.u - coordinate)[decoded.valid] > 0.5 * SIZE[0] / 57.0
        results += [
            above(f"measured_by_cells_of_a_{name}", float(decoded.valid.mean()), "", 0.97),
            below(f"wrong_orders_by_cells_of_a_{name}", float(wrong.mean()), "", 1e-4),
        ]
    return results


def _speed() -> Iterator[Result]:
    """Time the decoder beside correlation with every coordinate of the grid in NumPy, in blocks.

    Of random coordinates and of a smooth scene, in which a pixel is like the one before.
    """
    for (name, sets), smooth in product(CODES.items(), (False, True)):
        coordinate, recording = _recorded(sets, RATIOS[1], 39_300, FULL_SHAPE, smooth=smooth)
        ends = (
            np.clip(coordinate + d, -0.5, SIZE[0] - 0.5).astype(np.float32) for d in (-REACH_PX, REACH_PX)
        )
        known, used = PossibleCoordinates(*ends), sets_of_axis(recording.plan, "x", with_fringes=True)
        few = replace(recording, frames=[frame[:2] for frame in recording.frames])
        decode_codes(few, "x", used)  # compiles
        limit = _seconds(partial(_correlate, recording))
        for label, bounds in (("", None), ("_guided", known)):
            seconds = _seconds(partial(decode_codes, recording, "x", used, bounds))
            yield below(f"seconds_of_{name}{'_smooth' * smooth}{label}", seconds, "s", limit)


def _five_megapixels() -> Iterator[Result]:
    """Processor seconds of 9 images of 2448 x 2048 of a smooth scene, which two quiet cores share."""
    coordinate, part = _recorded(CODES["micro_9_images"], RATIOS[1], 39_400, (256, 2448), smooth=True)
    recording = replace(part, frames=[frame[np.arange(8 * 256) % 256] for frame in part.frames])
    ends = (np.tile((coordinate + d).astype(np.float32), (8, 1)) for d in (-REACH_PX, REACH_PX))
    known, used = PossibleCoordinates(*ends), sets_of_axis(recording.plan, "x", with_fringes=True)
    for label, bounds, allowed_s in (("", None, 2.0), ("_guided", known, 0.7)):
        seconds = _seconds(partial(decode_codes, recording, "x", used, bounds))
        yield below(f"processor_seconds_of_5_megapixels{label}", seconds, "s", 2 * allowed_s)


def _seconds(run: Callable[[], object]) -> float:
    begin = time.process_time()
    run()
    return time.process_time() - begin


def _correlate(recording: Recording) -> Floats:
    table = code_table(recording.plan.sets, "x", SIZE, Lattice.SQUARE, BLUR_PX)
    codes = table.unit[:, : len(table.coordinate)]
    levels = np.stack([frame.ravel() for frame in recording.frames], axis=1).astype(np.float32)
    levels -= levels.mean(axis=1, keepdims=True)
    blocks = np.array_split(levels, max(1, len(levels) // 4096))
    best = np.concatenate([np.argmax(block @ codes, axis=1) for block in blocks])
    return np.asarray(table.coordinate[best])
