"""A Bayer camera beside one without colours: noise by colour, a board, and the colours of points.

Frames of the first part follow formulas of fringes and of a sensor with shot noise. The bound is the
scatter of a phase by equal steps under the noise of each pixel, which a camera without colours has too that
gets as much light. Board and card are the twin's, lit by three LEDs.
"""

import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks import Result, above, below
from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.conventions import TWO_PI, Floats, Image
from fpplab.devices.rig import Rig
from fpplab.patterns.fringe_sets import LedName
from fpplab.patterns.fringe_sets.even import Even
from fpplab.patterns.mosaic import Bayer, colour_factors
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.pipeline.characterising import characterise_sessions
from fpplab.pipeline.measuring import reconstruct_points
from fpplab.pipeline.taking import take_or_resume_session
from fpplab.targets import Target
from sim.sensor import Led, photopic_efficiency
from sim.world.camera import ColourFilter

SIZE, SHAPE = (912, 1140), (256, 384)
FULL_E, READ_E, BITS = 15_000.0, 5.0, 12
AMBIENT, CONTRAST = 0.02, 0.9
PIXELS: dict[str, tuple[float, float, float]] = {  # by the part, light of red, green and blue pixels
    "grey": (0.5, 0.8, 0.35),
    "red": (0.5, 0.15, 0.1),
}
SETS = [{"axis": "x", "stripes": stripes, "steps": 8} for stripes in (1, 8, 64)]
PLAN = config.validate({"fringes": SETS}, Plan, "benchmark")
SEEDS = range(61_000, 61_003)
WITHIN = 1.1
COLOURS: tuple[LedName, LedName, LedName] = ("red", "green", "blue")
LEDS = Led(60.0, 625.0), Led(110.0, 525.0), Led(15.0, 460.0)
FILTER = ColourFilter(pattern="GRBG")
CARD, EXPOSURES_S = (0.8, 0.4, 0.2), (0.004, 0.0114)  # of as much light without a filter and with one


def run() -> list[Result]:
    """Measure both parts; two minutes on a quiet core."""
    return [result for seed in SEEDS for result in _noise(seed)] + _board_and_card()


def _noise(seed: int) -> list[Result]:
    random = np.random.default_rng(seed)
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    waves = random.uniform(20.0, 40.0, 2)
    bayer: Bayer = ("RGGB", "GRBG", "GBRG", "BGGR")[seed % 4]
    parts = [colour_factors(SHAPE, bayer, PIXELS[name]) for name in ("grey", "red")]
    light = np.where(u < SHAPE[1] // 2, parts[0], parts[1]) * np.where((v // 37 + u // 41) % 2, 1.0, 0.6)
    coordinate = 60.0 + 2.0 * u + 1.5 * np.sin(v / waves[0]) * np.sin(u / waves[1])
    frames, slopes, variances = [], np.zeros(SHAPE), np.zeros(SHAPE)
    rate = TWO_PI * 64 / SIZE[0]
    for each in PLAN.sets:
        for step in range(each.images):
            shown = 0.5 + CONTRAST * (each.light(step, coordinate, SIZE[0]) - 0.5)
            mean = FULL_E * light * (AMBIENT + (1.0 - AMBIENT) * shown)
            frames.append(_exposed(mean, random))
            if each is PLAN.sets[-1]:
                phase = rate * (coordinate + 0.5) - TWO_PI * step / 8
                slope = FULL_E * light * (1.0 - AMBIENT) * 0.5 * CONTRAST * rate * np.sin(phase)
                variances += slope**2 * (mean + READ_E**2)
                slopes += slope**2
    decoded = decode(Recording(frames, PLAN, SIZE, BITS, bayer=bayer))
    error, bound = decoded.u - coordinate, np.sqrt(variances) / slopes
    results = []
    for colour, name in zip(np.eye(3), COLOURS, strict=True):
        chosen = decoded.valid & (colour_factors(SHAPE, bayer, (colour[0], colour[1], colour[2])) > 0)
        over_bound = float(np.sqrt(np.mean((error / bound)[chosen] ** 2)))
        over_stated = float(np.sqrt(np.mean((error / decoded.sigma)[chosen] ** 2)))
        results += [
            below(f"error_over_bound_of_{name}_of_seed_{seed}", over_bound, "", WITHIN),
            below(f"error_over_stated_of_{name}_of_seed_{seed}", over_stated, "", WITHIN),
            above(f"error_over_stated_at_least_of_{name}_of_seed_{seed}", over_stated, "", 0.9),
        ]
    return [*results, above(f"completeness_of_seed_{seed}", float(decoded.valid.mean()), "", 0.99)]


def _exposed(mean: Floats, random: np.random.Generator) -> Image:
    electrons = random.poisson(mean) + READ_E * random.standard_normal(SHAPE)
    full = 2**BITS - 1
    image: Image = np.rint(full * np.clip(0.02 + 0.98 * electrons / FULL_E, 0.0, 1.0)).astype(np.uint16)
    return image


def _board_and_card() -> list[Result]:
    with tempfile.TemporaryDirectory() as folder:
        mono, coloured = (_twin(Path(folder), bayer) for bayer in (None, config.plain(FILTER)))
    assert coloured[1] is not None
    assert mono[1] is not None
    by_leds = float(np.abs(mono[1] / mono[1].sum() - np.array(CARD) / sum(CARD)).max())
    shares = coloured[1] / coloured[1].sum()
    # Filters overlap, which no white balance undoes; what is left beside them is the black level.
    lit = np.array([led.lumens * led.wavelength_nm / photopic_efficiency(led.wavelength_nm) for led in LEDS])
    passed = np.array([FILTER.red, FILTER.green, FILTER.blue]) * lit
    seen = (passed @ CARD) / passed.sum(axis=1)
    return [
        below("board_rms_over_that_without_colours", coloured[0] / mono[0], "", WITHIN),
        below("colour_of_card_off_by_leds", by_leds, "", 0.02),
        below("colour_of_card_off", float(np.abs(shares - np.array(CARD) / sum(CARD)).max()), "", 0.06),
        below("colour_of_card_off_by_filters", float(np.abs(shares - seen / seen.sum()).max()), "", 0.02),
    ]


def _twin(folder: Path, bayer: dict[str, Any] | None) -> tuple[float, Floats | None]:
    """Joint error in px of a characterisation, and the median colour of a card of three colours."""
    folder = folder / ("coloured" if bayer else "mono")
    folder.mkdir()
    world = yaml.safe_load(config.find_config("world_demo", "world").read_text())
    world["camera"] |= {"bayer": bayer} if bayer else {}
    leds = dict(zip(COLOURS, LEDS, strict=True))
    world["projector"] |= {"leds": {name: asdict(led) for name, led in leds.items()}, "lit": list(leds)}
    world["items"]["grey_card"]["material"] = "card"
    world["materials"] = {"card": {"reflectance": 0.9, "colour": [c / 0.9 for c in CARD]}}
    (folder / "world.yaml").write_text(yaml.safe_dump(world))
    rig_file = yaml.safe_load(config.find_config("rig_demo_quick", "rig").read_text())
    rig_file["bench"] |= {"world": "world.yaml", "analytic": True}
    (folder / "rig.yaml").write_text(yaml.safe_dump(rig_file))
    board = Plan.load("plan_board")
    even = [] if bayer else [Even(levels=(1.0, 0.0), led=led) for led in COLOURS]
    sets = (*board.sets[:3], *even, *board.sets[3:])
    plan = board.model_copy(update={"fringes": sets, "exposure_s": EXPOSURES_S[bayer is not None]})
    with Rig.load(folder / "rig.yaml") as rig:
        poses = [take_or_resume_session(rig, plan, folder / f"{k}", ("board", k)) for k in range(6)]
        card = take_or_resume_session(rig, plan, folder / "card", ("grey_card", 0))
        known = characterise_sessions(poses, Target.load("target_paper"))
        calibration: Calibration = known.calibration
        rms_px = calibration.rms_px["joint"]
        _, cloud = reconstruct_points(card, calibration)
    return rms_px, None if cloud.rgb is None else np.median(cloud.rgb, axis=0)
