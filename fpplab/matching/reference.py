"""What a bench has recorded of its board, read once: frames, characterisation, response."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fpplab.characterisation import Characterisation
from fpplab.core.conventions import Lattice, full_scale
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Response
from fpplab.sessions.session import Session
from fpplab.targets import Target

LevelStack = NDArray[np.float32]
"""Raw levels of frames, (n, h, w)."""

SPREAD = 4


@dataclass(frozen=True, eq=False)
class Reference:
    """Sessions of a board, one per pose that could be characterised, and what they told.

    response: of projector and camera, where it was measured.
    """

    sessions: tuple[Session, ...]
    target: Target
    characterisation: Characterisation
    response: Response | None = None

    @classmethod
    def of(
        cls,
        sessions: Sequence[Session],
        target: Target,
        characterisation: Characterisation,
        response: Response | None = None,
    ) -> Reference:
        """The sessions whose poses the characterisation used, in its order."""
        by_name = {session.path.name: session for session in sessions}
        used = tuple(by_name[o.name] for o in characterisation.observations)
        return cls(used, target, characterisation, response)

    @property
    def plan(self) -> Plan:
        return self.sessions[0].plan

    @property
    def settings(self) -> CameraSettings:
        return self.sessions[0].records[0].settings

    @property
    def epsilon_r(self) -> float:
        """Joint RMS reprojection error in px."""
        return self.characterisation.calibration.rms_px["joint"]

    @property
    def full_scale(self) -> int:
        return full_scale(self.settings.bits)

    @property
    def projector(self) -> tuple[tuple[int, int], Lattice]:
        return self.sessions[0].projector()

    @cached_property
    def patterns(self) -> tuple[Pattern, ...]:
        """Every pattern of the plan, in the order shown."""
        return make_patterns(self.plan, *self.projector)

    @cached_property
    def one_of_each_set(self) -> tuple[int, ...]:
        """The first image of every fringe set."""
        return tuple(index for index, (_, step, _) in enumerate(self.plan.steps()) if step == 0)

    @cached_property
    def finest(self) -> tuple[int, ...]:
        """Of the finest set along every axis two images a quarter of a period apart: none of both is flat."""
        wanted = {self.plan.sets_along(axis)[-1] for axis in self.plan.axes}
        return tuple(
            index
            for index, (fringes, step, _) in enumerate(self.plan.steps())
            if fringes in wanted and step in (0, max(1, round(self.plan.fringes[fringes].images / 4)))
        )

    @cached_property
    def finest_spread(self) -> tuple[int, ...]:
        """Of the finest set along every axis up to `SPREAD` images, evenly over the period."""
        wanted = {self.plan.sets_along(axis)[-1] for axis in self.plan.axes}
        found = []
        for index, (fringes, step, _) in enumerate(self.plan.steps()):
            every = max(1, self.plan.fringes[fringes].images // SPREAD)
            if fringes in wanted and step % every == 0 and step // every < SPREAD:
                found.append(index)
        return tuple(found)

    def shown(self, images: Sequence[int]) -> tuple[Pattern, ...]:
        """The patterns of some images."""
        return tuple(self.patterns[index] for index in images)

    def frames(self, pose: int, images: Sequence[int]) -> LevelStack:
        """Some frames of a pose, float32."""
        return np.stack([self.sessions[pose].read(i, verify=False) for i in images]).astype(np.float32)

    def spread_poses(self, count: int) -> tuple[int, ...]:
        """So many poses, spread over the depths at which the board was held."""
        depths = np.array([pose.translation[2] for pose in self.characterisation.poses])
        order = np.argsort(depths)
        chosen = np.rint(np.linspace(0, len(order) - 1, min(count, len(order)))).astype(int)
        return tuple(int(i) for i in order[chosen])
