"""The reference: what was recorded of the bench's board, with its frames, characterisation and response."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.characterisation import Characterisation
from fpplab.core.conventions import Image, Lattice, full_scale
from fpplab.core.errors import ConfigError
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Response
from fpplab.sessions.session import Session
from fpplab.targets import Target

LevelStack = NDArray[np.float32]  # raw levels of frames, (n, h, w)


@dataclass(frozen=True)
class ReferenceLimits:
    """What of the recordings is looked at."""

    finest_images: int = 4  # of a fringe set, at most (chosen, for speed)
    dark_poses: int = 8  # in which the darkest places are looked for (chosen, for speed)
    dark_px: int = 5  # side of the squares whose mean is a place's level (chosen)
    darkest_share: float = 1e-3  # of the places, which may be darker (chosen)


LIMITS = ReferenceLimits()


@dataclass(frozen=True, eq=False)
class Reference:
    """Recordings of a board on the bench, one session for each pose, and what was found from them."""

    sessions: tuple[Session, ...]  # of the poses that the characterisation used, in its order
    target: Target  # the board
    characterisation: Characterisation  # found from the sessions
    response: Response | None = None  # of projector and camera, where it was measured

    @classmethod
    def of(
        cls,
        sessions: Sequence[Session],
        target: Target,
        characterisation: Characterisation,
        response: Response | None = None,
    ) -> Reference:
        """Choose the sessions whose poses the characterisation used."""
        sessions[0].plan.refuse_exposures("matching")
        if sessions[0].bayer:
            raise ConfigError(f"{sessions[0].path}: matching takes a camera without a Bayer filter")
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
    def reference_rms_px(self) -> float:
        """Joint RMS reprojection error in px."""
        return self.characterisation.calibration.rms_px["joint"]

    @property
    def is_steady(self) -> bool:
        """Whether the projector's picture stayed where it was from pose to pose."""
        sizes = self.characterisation.sizes
        return sizes is None or not sizes.drift_px

    @property
    def full_scale(self) -> int:
        """The greatest raw level of the frames."""
        return full_scale(self.settings.bits)

    @cached_property
    def darkest_level(self) -> float:
        """Mean raw level of the darkest places of all recordings: the camera's black is not above it."""
        darkest = []
        for pose in self.spread_poses(LIMITS.dark_poses):
            mean = np.mean(self.recorded(pose), axis=0, dtype=np.float64)
            darkest.append(
                float(np.quantile(cv2.blur(mean, (LIMITS.dark_px, LIMITS.dark_px)), LIMITS.darkest_share))
            )
        return min(darkest)

    @property
    def projector(self) -> tuple[tuple[int, int], Lattice]:
        """Size (width, height) in mirrors and lattice of the projector."""
        return self.sessions[0].projector()

    @cached_property
    def patterns(self) -> tuple[Pattern, ...]:
        return make_patterns(self.plan, *self.projector)

    @cached_property
    def one_of_each_set(self) -> tuple[int, ...]:
        """Indices of the first image of every fringe set."""
        return tuple(index for index, (_, step, _) in enumerate(self.plan.steps()) if step == 0)

    @cached_property
    def finest(self) -> tuple[int, ...]:
        """Two images of the finest set along each axis, a quarter of a period apart: not both extreme."""
        sets = {self.plan.finest_set(axis) for axis in self.plan.axes}
        return tuple(
            index
            for index, (fringes, step, _) in enumerate(self.plan.steps())
            if fringes in sets and step in (0, max(1, round(self.plan.fringes[fringes].images / 4)))
        )

    @cached_property
    def finest_spread(self) -> tuple[int, ...]:
        """Up to `finest_images` images of the finest set along every axis, evenly spaced over the period."""
        sets = {self.plan.finest_set(axis) for axis in self.plan.axes}
        images = []
        for index, (fringes, step, _) in enumerate(self.plan.steps()):
            every = max(1, self.plan.fringes[fringes].images // LIMITS.finest_images)
            if fringes in sets and step % every == 0 and step // every < LIMITS.finest_images:
                images.append(index)
        return tuple(images)

    @cached_property
    def compared(self) -> tuple[int, ...]:
        """Images by which pixels of bench and twin are compared: the finest, and one of each set."""
        return tuple(sorted({*self.finest_spread, *self.one_of_each_set}))

    def shown(self, images: Sequence[int]) -> tuple[Pattern, ...]:
        return tuple(self.patterns[index] for index in images)

    def frames(self, pose: int, images: Sequence[int]) -> LevelStack:
        """Read some frames of a pose; their checksums are not verified."""
        # returns (n, h, w)
        return np.stack([self.sessions[pose].read(i, verify=False) for i in images]).astype(np.float32)

    def recorded(self, pose: int) -> list[Image]:
        """Read all frames of a pose as they were recorded; their checksums are not verified."""
        return [self.sessions[pose].read(index, verify=False) for index in range(len(self.patterns))]

    def spread_poses(self, count: int) -> tuple[int, ...]:
        """Choose poses that are evenly spread over the depths of the board."""
        depths = np.array([pose.translation[2] for pose in self.characterisation.poses])
        order = np.argsort(depths)
        chosen = np.rint(np.linspace(0, len(order) - 1, min(count, len(order)))).astype(int)
        return tuple(int(i) for i in order[chosen])
