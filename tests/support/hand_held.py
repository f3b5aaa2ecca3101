"""A rig by formulas whose board a hand holds about where it should, and now and then badly."""

from collections import deque
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fpplab.core import config
from fpplab.core.conventions import Image
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings, DeviceInfo, FixtureCaps, PosableFixture
from fpplab.devices.rig import Rig, RigFile
from fpplab.patterns.fringes import Pattern
from tests.support.faulty_bench import Bench, healthy, plan_of
from tests.support.plane_twin import PlaneTwin, nominal

PLAN = plan_of(("x", 1, 4), ("x", 16, 4), ("y", 1, 4), ("y", 12, 4))
FIRST = RigidTransform.from_vectors(np.radians([-25.0, 0.0, 0.0]), np.array([0.0, 0.0, 450.0]))
ASIDE = RigidTransform(np.eye(3), np.array([400.0, 0.0, 450.0]))


@dataclass
class HandBench:
    """The board and what is wrong with how it is held, by the number of the attempt from 0."""

    options: dict[str, Any]

    def open(self) -> None:
        self.faults: dict[int, str] = {int(k): v for k, v in self.options.get("faults", {}).items()}
        self.random = np.random.default_rng([8, int(self.options["seed"])])
        self.on_show: Pattern | None = None
        self.pulses: deque[Pattern] = deque()
        self.frames_to_lose = 0
        self.attempt = -2
        self.hold(FIRST)

    def close(self) -> None:
        self.on_show = None

    @property
    def now(self) -> Bench:
        """The bench as it stands, for the formula devices."""
        return replace(healthy(0), parameters=self._twin.parameters)

    def hold(self, pose: RigidTransform) -> None:
        """Hold the board, some mm and degrees off; the next frames are of this attempt."""
        self.attempt, self.frames = self.attempt + 1, 0
        turn, shift = self.random.normal(0, np.radians(3.0), 3), self.random.normal(0, 3.0, 3)
        turned = pose.rotation @ RigidTransform.from_vectors(turn, np.zeros(3)).rotation
        self.held = RigidTransform(turned, pose.translation + shift)
        fault = self.faults.get(self.attempt)
        if fault == "hidden":
            self.held = ASIDE
        parameters = nominal([self.held])
        if fault == "defocused":
            parameters = replace(parameters, camera_focus_mm=300.0)
        if fault == "saturated":
            parameters = replace(parameters, white=2.2)
        self._twin = PlaneTwin(parameters)

    def image(self, pattern: Pattern | None, settings: CameraSettings) -> Image:
        """What the camera sees of a pattern, or of darkness."""
        now = self._twin.parameters
        if self.faults.get(self.attempt) == "moved" and self.frames == 8:
            slipped = RigidTransform(self.held.rotation, self.held.translation + np.array([0.0, 0.35, 0.0]))
            self._twin = PlaneTwin(replace(now, poses=(slipped,)))
        self.frames += 1
        shown = pattern or Pattern("", np.zeros(now.calibration.projector.size[::-1], np.uint8))
        still = np.asarray(self._twin.expected(0, [shown], settings), np.float64)
        return replace(self.now, bits=settings.bits).digitised(still, self.random)[0]


class HandFixture(PosableFixture):
    """Holds the board where it is told, as a hand does."""

    def _setup(self, options: dict[str, Any], shared: Any) -> None:
        self._bench = shared

    def _open(self) -> None:
        """Nothing to do."""

    def _close(self) -> None:
        """Nothing to do."""

    def _info(self) -> DeviceInfo:
        return DeviceInfo("fixture", "hand", "", "formulas")

    def _caps(self) -> FixtureCaps:
        return FixtureCaps({"board": None})

    def _mount(self, item: str, pose: int) -> None:
        self._bench.hold(FIRST)

    def _pose(self, item: str, pose: int) -> RigidTransform:
        return FIRST

    def _place(self, item: str, T_camera_item: RigidTransform) -> None:
        self._bench.hold(T_camera_item)


def hand_held_rig(faults: dict[int, str] | None = None, seed: int = 0) -> Rig:
    """The rig, not open yet."""
    by_hand, formulas = "tests.support.hand_held:Hand", "tests.support.faulty_rig:Formula"
    bench = {
        "backend": by_hand + "Bench",
        "seed": seed,
        "faults": {str(k): v for k, v in (faults or {}).items()},
    }
    sections = {
        "bench": bench,
        "camera": {"backend": formulas + "Camera"},
        "projector": {"backend": formulas + "Projector"},
        "fixture": {"backend": by_hand + "Fixture"},
    }
    return Rig(config.validate({"name": "by hand", **sections}, RigFile, "rig"), Path(), "rig.yaml")
