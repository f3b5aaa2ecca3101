"""Patterns of few bits: their noise beside that of eight bits, and how long nine images take.

Frames are made from the patterns' own images with a Gaussian blur; the time is that of the emulated
projector's and camera's clocks.
"""

import tempfile
from pathlib import Path
from unittest.mock import patch

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from benchmarks import Result, above, below
from drivers.dlp4500.sequence import SIZE as FLASH
from fpplab.core import config
from fpplab.core.conventions import Lattice
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.setup.plan_preview import preview_plan
from tests.drivers.emulated_rig import bench_of, burn, rig_file, taken

SIZE, SHAPE = (912, 1140), (400, 600)
DARK, SWING, NOISE = 20.0, 200.0, 0.05  # grey levels; noise as a share of the modulation
BLUR_PX = 0.6  # of lens and mirrors together, in projector px
BITS = 4
WITHIN, STATED = 1.1, (0.95, 1.05)
PLANES = 48  # that the projector shows at its full rate
FASTER = 5.0


def _plan(bits: int | None, steps: int, exposure_s: float = 0.02, trigger: str = "triggered") -> Plan:
    sets = tuple(Sinusoid(axis="x", stripes=s, steps=steps, pattern_bits=bits) for s in (1, 8, 64))
    return Plan.model_validate({"fringes": sets, "exposure_s": exposure_s, "trigger": trigger})


def run() -> list[Result]:
    """Compare noise, planes and seconds; a minute on a quiet core."""
    results = []
    for steps, seed in ((3, 39_500), (4, 39_501), (6, 39_502)):
        (full, _), (few, stated) = (_spread(_plan(bits, steps), seed) for bits in (None, BITS))
        results += [
            below(f"noise_of_{BITS}_bits_{steps}_steps", few, "px", WITHIN * full),
            above(f"noise_over_stated_{steps}_steps", few / stated, "", STATED[0]),
            below(f"noise_over_stated_{steps}_steps", few / stated, "", STATED[1]),
        ]
    return [*results, *_times()]


def _spread(plan: Plan, seed: int) -> tuple[float, float]:
    """Spread of the coordinate in px, and the stated one."""
    random = np.random.default_rng(seed)
    column, row = np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0]))
    u, v = 50.3 + 1.02 * column + 0.11 * row, 40.7 + 1.04 * row - 0.07 * column
    frames = []
    for pattern in make_patterns(plan, SIZE, Lattice.SQUARE):
        light = map_coordinates(gaussian_filter(pattern.image / 255.0, BLUR_PX), [v, u], order=1)
        noisy = DARK + SWING * light + 0.5 * SWING * NOISE * random.standard_normal(u.shape)
        frames.append(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    decoded = decode(Recording(tuple(frames), plan, SIZE, 8, "frames"))
    valid = np.isfinite(decoded.u)
    return float(np.std((decoded.u - u)[valid])), float(np.sqrt(np.mean(decoded.sigma[valid] ** 2)))


def _times() -> list[Result]:
    paper, few = _plan(None, 12), _plan(BITS, 3, exposure_s=0.002)
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        held = [p for plan in (paper, few) for p in make_patterns(plan, FLASH, Lattice.DIAMOND)]
        burn(Path(folder), held)
        optics = {"optics": str(config.find_config("rig_demo_quick", "rig"))}
        with rig_file(Path(folder), optics, {"bits": 8, "roi": [0, 0, 684, 456]}) as rig:
            foretold = preview_plan(rig, few, "plan")[0]
            measured_s, paper_s = scan_seconds(rig, few), scan_seconds(rig, paper)
    return [
        below("planes_of_nine_images", float(foretold.bit_planes), "", float(PLANES)),
        below("seconds_of_nine_images", measured_s, "s", 1.01 * foretold.least_s),
        above("times_as_fast_as_36_images", paper_s / measured_s, "", FASTER),
    ]


def scan_seconds(rig: Rig, plan: Plan) -> float:
    """From the first exposure to the last, and one period more, by the emulated clock."""
    shutter = bench_of(rig).shutter
    with patch.object(shutter, "open", wraps=shutter.open) as opened:
        frames = list(taken(rig, plan, make_patterns(plan, FLASH, Lattice.DIAMOND)))
    begun = [call.args[1] for call in opened.call_args_list[: len(frames)]]
    return float(begun[-1] - begun[0]) * len(begun) / (len(begun) - 1)
