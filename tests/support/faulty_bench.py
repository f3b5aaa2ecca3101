"""A bench by formulas with one fault of a strength that a seed draws, lit by the plane twin."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.conventions import Floats, Image, Lattice, full_scale
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings
from fpplab.patterns.curve import Curve
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from sim.parameters import TwinParameters
from tests.support.plane_twin import PlaneTwin, nominal, tilted


def plan_of(*sets: tuple[str, float, int]) -> Plan:
    fringes = [{"axis": axis, "stripes": stripes, "steps": steps} for axis, stripes, steps in sets]
    return config.validate({"fringes": fringes}, Plan, "plan")


PLANS = {
    "twelve": plan_of(("x", 1, 12), ("x", 8, 12), ("x", 60, 12)),
    "four": plan_of(("x", 1, 4), ("x", 8, 4), ("x", 60, 4)),
    "three": plan_of(("x", 1, 3), ("x", 8, 3), ("x", 60, 3)),
    "both": plan_of(("x", 1, 4), ("x", 8, 4), ("x", 60, 8), ("y", 1, 4), ("y", 6, 4), ("y", 40, 8)),
    "rows": plan_of(("y", 1, 6), ("y", 6, 6), ("y", 40, 6)),
}


@dataclass(frozen=True)
class Bench:
    """A bench and what is done to its frames."""

    parameters: TwinParameters
    plan: Plan
    bits: int = 8
    flicker: float = 0.0
    vibration_mm: float = 0.0
    known: Calibration | None = None
    """The calibration that is believed; by default the true one."""
    seed: int = 0
    window: float = 1.0
    """Share of the projector's width and height that reaches what the camera sees."""
    third: float = 0.0
    """Third harmonic of the display, as a share of a fringe."""
    scale: float = 1.0
    """By which the picture is made smaller and larger again before it is shown."""
    bounce: float = 0.0
    """Share of light that comes mirrored from the other half of the scene."""
    bounce_blur_px: float = 2.0
    dark_colour: tuple[int, float] = (0, 1.0)
    """Which of three colours is weak, and its share of the others' light."""
    bands: float = 0.0
    """Amplitude of the rows' brightness, with another phase in each frame."""
    stated: Plan | None = None
    """The plan that the frames are said to be of; by default that which was shown."""
    mains_hz: float = 0.0
    """Frequency of a lamp whose light changes by `mains`."""
    mains: float = 0.0

    @property
    def calibration(self) -> Calibration:
        known = self.known or self.parameters.calibration
        return replace(known, rms_px={"camera": 0.1, "projector": 0.1, "joint": 0.1})

    def recording(self) -> Recording:
        """The frames of the first pose."""
        random = np.random.default_rng(self.seed)
        settings = CameraSettings(0.02, 0.0, self.bits)
        size = self.parameters.calibration.projector.size
        shown = [self.reaching(one) for one in make_patterns(self.plan, size, Lattice.SQUARE)]
        patterns = [self.coloured(one, k) for k, one in enumerate(shown)]
        twin = PlaneTwin(self.parameters)
        still = twin.expected(0, patterns, settings)
        gains = 1 + self.flicker * random.standard_normal((len(still), 1, 1))
        gains = gains * np.stack([self.of_rows(still.shape[1], random) for _ in still])
        seen = self.with_bounce(still) * gains
        if self.vibration_mm:
            for slope in twin.slopes_per_mm(0, patterns, settings, still):
                seen = seen + random.normal(0, self.vibration_mm, (len(still), 1, 1)) * slope
        frames = self.digitised(np.asarray(seen, np.float64), random)
        return Recording(frames, self.stated or self.plan, size, self.bits, "bench")

    def reaching(self, pattern: Pattern) -> Pattern:
        """What of a pattern reaches what the camera sees, as the display shows it."""
        image = pattern.image
        if self.scale != 1.0:
            there = [round(self.scale * n) for n in image.shape[::-1]]
            small = cv2.resize(image, there, interpolation=cv2.INTER_NEAREST)
            image = cv2.resize(small, image.shape[::-1], interpolation=cv2.INTER_NEAREST)
        if self.third:
            wave = image / 127.5 - 1.0
            bent = wave + self.third * (4 * wave**3 - 3 * wave)
            image = np.rint(127.5 * (bent.clip(-1, 1) + 1.0)).astype(np.uint8)
        return _windowed(replace(pattern, image=image), self.window)

    def coloured(self, pattern: Pattern, index: int) -> Pattern:
        """The pattern in the colour of its place."""
        colour, share = self.dark_colour
        if index % 3 != colour or share == 1.0:
            return pattern
        return replace(pattern, image=np.rint(share * pattern.image).astype(np.uint8))

    def with_bounce(self, still: Floats) -> Floats:
        """Frames (K, rows, columns) with light that faces of a valley send each other."""
        if not self.bounce:
            return still
        mirrored = np.ascontiguousarray(still[:, :, ::-1], np.float32)
        other = [cv2.GaussianBlur(one, (0, 0), self.bounce_blur_px) for one in mirrored]
        return np.asarray(still + self.bounce * np.stack(other))

    def of_rows(self, rows: int, random: np.random.Generator) -> Floats:
        """Gain (rows, 1) of the rows of a frame."""
        if not self.bands:
            return np.ones((rows, 1))
        turn = 2 * np.pi * (1.7 * np.arange(rows) / rows + random.uniform())
        return np.asarray(1.0 + self.bands * np.cos(turn))[:, None]

    def digitised(self, expected: Floats, random: np.random.Generator) -> list[Image]:
        """Grey levels with the sensor's noise."""
        now, full = self.parameters, full_scale(self.bits)
        electrons = now.full_well_e * np.maximum(expected / full - now.black_level, 0)
        sigma = np.sqrt(electrons + (4 * now.read_noise_e) ** 2) * full / now.full_well_e
        noisy = expected + sigma * random.standard_normal(expected.shape)
        return list(np.rint(noisy).clip(0, full).astype(np.uint8 if self.bits == 8 else np.uint16))


def healthy(seed: int) -> Bench:
    """A good bench: a plan of four, 8 or 12 bits, a bright or dark board anywhere, a little of everything."""
    random = np.random.default_rng([seed, 7])
    board = nominal(tilted(1, seed))
    paper = float(random.choice([0.15, 0.4, 0.9]))
    board = replace(
        board,
        paper=paper,
        ink=0.06 * paper,
        white=float(random.uniform(0.7, 1.1)),
        ambient=float(random.uniform(0.0, 0.05)),
        projector_blur=float(random.uniform(0.4, 1.0)),
        response=Curve(a=0.98, b=0.02, g=float(random.uniform(0.99, 1.01))),
    )
    names = ["twelve", "four", "three", "both"]
    plan, bits = PLANS[names[seed % 4]], int(random.choice([8, 12]))
    return Bench(board, plan, bits, flicker=0.0005, vibration_mm=0.001, seed=seed)


Fault = Callable[[Bench, np.random.Generator], Bench]


def _with(**drawn: tuple[float, float]) -> Fault:
    def fault(bench: Bench, random: np.random.Generator) -> Bench:
        values: dict[str, Any] = {name: float(random.uniform(*span)) for name, span in drawn.items()}
        return replace(bench, parameters=replace(bench.parameters, **values))

    return fault


def _bent(bench: Bench, random: np.random.Generator) -> Bench:
    three = bool(random.uniform() < 0.5)  # four steps cancel what a moderate gamma does
    response = Curve(a=0.98, b=0.02, g=float(random.uniform(1.4 if three else 2.2, 2.4)))
    plan = PLANS["three" if three else "four"]
    return replace(bench, plan=plan, parameters=replace(bench.parameters, response=response))


def _dark(bench: Bench, random: np.random.Generator) -> Bench:
    ambient = float(random.uniform(0.0, 0.3))
    response = Curve(a=1e-6, b=0.0, g=1.0)
    return replace(bench, parameters=replace(bench.parameters, response=response, ambient=ambient))


def _small_angle(bench: Bench, random: np.random.Generator) -> Bench:
    """The projector beside the camera, 10 to 25 mm at 450 mm."""
    beside = RigidTransform(np.eye(3), np.array([-random.uniform(10, 25), 0, 0]))
    known = replace(bench.parameters.calibration, T_projector_camera=beside)
    principal = known.projector.matrix.copy()
    principal[1, 2] = 142.0
    known = replace(known, projector=replace(known.projector, matrix=principal))
    return replace(bench, parameters=replace(bench.parameters, calibration=known))


def _turned(calibration: Calibration, degrees: tuple[float, float, float]) -> Calibration:
    turn = RigidTransform.from_vectors(np.radians(degrees), np.zeros(3))
    return replace(calibration, T_projector_camera=turn @ calibration.T_projector_camera)


def _stale(bench: Bench, random: np.random.Generator) -> Bench:
    turn = float(random.uniform(0.4, 1.0)) * (1 if random.uniform() < 0.5 else -1)
    known = _turned(bench.parameters.calibration, (turn, 0.0, 0.0))
    return replace(bench, plan=PLANS["both"], known=known)


def _scaled(bench: Bench, random: np.random.Generator) -> Bench:
    return replace(bench, scale=float(random.uniform(0.5, 0.92)))


def _odd(bench: Bench, random: np.random.Generator) -> Bench:
    return replace(bench, plan=PLANS["four"], third=float(random.uniform(0.06, 0.3)))


def _valley(bench: Bench, random: np.random.Generator) -> Bench:
    blur = float(random.uniform(1.0, 4.0))
    bounce = float(random.uniform(0.15, 0.5))
    # As much light as before, or the image would be saturated besides.
    exposed = replace(bench.parameters, white=bench.parameters.white / (1.0 + bounce))
    return replace(bench, bounce=bounce, bounce_blur_px=blur, parameters=exposed)


def _colourless(bench: Bench, random: np.random.Generator) -> Bench:
    colour = int(random.integers(3)), float(random.choice([0.0, 0.3, 0.6]))
    return replace(bench, dark_colour=colour)


def _banded(bench: Bench, random: np.random.Generator) -> Bench:
    return replace(bench, bands=float(random.uniform(0.04, 0.2)))


def _misstated(bench: Bench, random: np.random.Generator) -> Bench:
    """Said to be of another plan: a set shifted the other way, two exchanged, or other stripes."""
    bench = replace(bench, plan=PLANS[str(random.choice(["twelve", "four"]))])
    sets, kind = list(bench.plan.fringes), int(random.integers(3))
    if kind == 0:
        k = int(random.integers(len(sets)))
        sets[k] = sets[k].model_copy(update={"shift_sign": -1})
    elif kind == 1:
        k = int(random.integers(len(sets) - 1))
        sets[k : k + 2] = sets[k + 1], sets[k]
    else:
        off = int(random.integers(3, 9)) * int(random.choice([-1, 1]))
        sets[-1] = sets[-1].model_copy(update={"stripes": sets[-1].stripes + off})
    return replace(bench, stated=bench.plan.model_copy(update={"fringes": tuple(sets)}))


def _mains(bench: Bench, random: np.random.Generator) -> Bench:
    hertz = float(random.choice([100.0, 120.0]))
    exposure_s = float(random.choice([0.004, 0.013, 0.027]))
    plan = bench.plan.model_copy(update={"exposure_s": exposure_s})
    depth = float(random.uniform(0.05, 0.3)) / max(float(abs(np.sinc(hertz * exposure_s))), 0.2)
    return replace(bench, plan=plan, mains_hz=hertz, mains=min(depth, 0.9))


def _windowed(pattern: Pattern, share: float) -> Pattern:
    """Dark but for the middle of the picture."""
    if share == 1.0:
        return pattern
    image = np.zeros_like(pattern.image)
    height, width = image.shape
    rows, columns = (
        slice(round(n * (0.55 - share / 2)), round(n * (0.55 + share / 2))) for n in (height, width)
    )
    image[rows, columns] = pattern.image[rows, columns]
    return replace(pattern, image=image)


FAULTS: dict[str, Fault] = {
    "camera_focus": _with(camera_focus_mm=(290.0, 330.0)),
    "projector_focus": _with(projector_blur=(4.0, 8.0)),
    "ambient": _with(ambient=(1.3, 2.0), white=(0.35, 0.4)),
    "response": _bent,
    "flicker": lambda bench, random: replace(bench, flicker=float(random.uniform(0.03, 0.1))),
    "vibration": lambda bench, random: replace(bench, vibration_mm=float(random.uniform(0.1, 0.5))),
    "saturated": _with(white=(2.0, 3.5)),
    "underexposed": _with(white=(0.012, 0.03)),
    "projector_dark": _dark,
    "no_overlap": lambda bench, random: replace(bench, window=float(random.uniform(0.05, 0.07))),
    "small_angle": _small_angle,
    "wrong_axis": lambda bench, _: replace(bench, plan=PLANS["rows"]),
    "stale_calibration": _stale,
    "harmonics": _odd,
    "interreflection": _valley,
    "wrong_resolution": _scaled,
    "missing_colour": _colourless,
    "bands": _banded,
    "wrong_plan": _misstated,
}
FAULTS_IN_TIME: dict[str, Fault] = {"mains_flicker": _mains}
"""Those that frames without their times do not show."""


def faulty(cause: str, seed: int) -> Bench:
    """A good bench of a bright board with one fault."""
    random = np.random.default_rng([seed, 3])
    bench = healthy(seed)
    good = replace(bench.parameters, paper=0.9, ink=0.05)
    return (FAULTS | FAULTS_IN_TIME)[cause](replace(bench, parameters=good), random)
