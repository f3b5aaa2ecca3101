"""The bench by formulas as devices, so that commands meet its faults as they meet a rig's."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fpplab.core import config
from fpplab.core.conventions import Image, Lattice
from fpplab.devices import CameraCaps, CameraSettings, ProjectorCaps, Trigger
from fpplab.devices.rig import Rig, RigFile
from fpplab.patterns.fringes import Pattern
from tests.conformance.reference import ReferenceCamera, ReferenceProjector
from tests.support.faulty_bench import Bench, faulty, healthy
from tests.support.plane_twin import PlaneTwin


@dataclass
class FormulaBench:
    """A bench drawn by a seed, with the fault that the rig file names or without."""

    options: dict[str, Any]

    def open(self) -> None:
        self.now = drawn(self.options.get("cause"), int(self.options["seed"]))
        self.on_show: Pattern | None = None
        self.pulses: deque[Pattern] = deque()
        self.frames_to_lose = 0
        self._twin = PlaneTwin(self.now.parameters)
        self._random = np.random.default_rng([self.now.seed, 5])
        self._now_s = 0.0

    def close(self) -> None:
        self.on_show = None

    def image(self, pattern: Pattern | None, settings: CameraSettings) -> Image:
        """What the camera sees of a pattern, or of darkness."""
        now, random = self.now, self._random
        size = now.parameters.calibration.projector.size
        shown = pattern or Pattern("", np.zeros(size[::-1], np.uint8))
        patterns = [now.reaching(shown)]
        expected = self._twin.expected(0, patterns, settings)
        still = np.asarray(expected[0], np.float64)
        if now.vibration_mm:
            slopes = self._twin.slopes_per_mm(0, patterns, settings, expected)[:, 0]
            still = still + np.tensordot(random.normal(0, now.vibration_mm, 3), slopes, axes=1)
        gain = (1 + now.flicker * random.standard_normal()) * now.of_rows(still.shape[0], random)
        self._now_s += settings.exposure_s + random.uniform(0.01, 0.05)
        turns = now.mains_hz * settings.exposure_s
        gain = gain * (1 + now.mains * np.sinc(turns) * np.cos(2 * np.pi * now.mains_hz * self._now_s))
        still = now.with_bounce(still[None])[0] * settings.exposure_s / now.plan.exposure_s
        return replace(now, bits=settings.bits).digitised((gain * still)[None], random)[0]


def drawn(cause: str | None, seed: int) -> Bench:
    """A bench with one fault, or a good one."""
    return faulty(cause, seed) if cause else healthy(seed)


class FormulaCamera(ReferenceCamera):
    """Sees the bench."""

    _bench: Any

    def _caps(self) -> CameraCaps:
        size = self._bench.now.parameters.calibration.camera.size
        triggers: tuple[Trigger, ...] = ("software", "hardware")
        return CameraCaps(size, (8, 12), (1e-4, 1.0), (0.0, 12.0), triggers, 0.004, period_s=0.0)

    def _levels(self, pattern: Pattern | None) -> Image:
        return np.asarray(self._bench.image(pattern, self._applied))


class FormulaProjector(ReferenceProjector):
    """Shows what it is given, each pattern in the colour of its place."""

    _bench: Any

    def _load(self, patterns: Sequence[Pattern]) -> Sequence[Pattern]:
        shown = [self._bench.now.coloured(one, k) for k, one in enumerate(patterns)]
        return super()._load(shown)

    def _caps(self) -> ProjectorCaps:
        size = self._bench.now.parameters.calibration.projector.size
        return ProjectorCaps(size, Lattice.SQUARE, {1: 2e-4, 8: 8e-3}, 1, 200)


class FormulaDevices(NamedTuple):
    """Where the devices of a rig by formulas come from, as `backend` says."""

    camera: str = f"{__name__}:FormulaCamera"
    projector: str = f"{__name__}:FormulaProjector"


def formula_rig(cause: str | None, seed: int, devices: FormulaDevices = FormulaDevices(), **more: Any) -> Rig:  # noqa: B008
    """The rig, not open yet; `more` goes to the bench, for devices that have faults of their own."""
    sections = {
        "bench": {"backend": f"{__name__}:FormulaBench", "seed": seed, "cause": cause, **more},
        "camera": {"backend": devices.camera},
        "projector": {"backend": devices.projector},
    }
    return Rig(config.validate({"name": "formulas", **sections}, RigFile, "rig"), Path(), "rig.yaml")
