"""The reference: what was recorded of the bench's board, with its frames, characterisation and response."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.characterisation import Characterisation
from fpplab.core.conventions import Image, Lattice, Map, axis_length, full_scale
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.mosaic import colour_factors
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.patterns.response import Response
from fpplab.sessions.session import Session
from fpplab.targets import Target
from sim.matching.passes import ComparedPass
from sim.twin import Twin

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
        by_name = {session.path.name: session for session in sessions}
        used = tuple(by_name[o.name] for o in characterisation.observations)
        return cls(used, target, characterisation, response)

    @property
    def plan(self) -> Plan:
        return self.sessions[0].plan

    @cached_property
    def compared_pass(self) -> ComparedPass:
        return ComparedPass.of(self.sessions[0])

    @property
    def settings(self) -> CameraSettings:
        return self.compared_pass.settings

    @cached_property
    def mosaic(self) -> Map | None:
        """Share of the light that each pixel of a Bayer camera has, relative to their mean."""
        # (height, width)
        bayer, white = self.sessions[0].bayer, self.characterisation.calibration.white
        if bayer is None or white is None:
            return None
        width, height, _ = self.sessions[0].format
        return colour_factors((height, width), bayer, white)

    def filtered(self, twin: Twin) -> Twin:
        """Give a twin the filter of the bench's camera, or none."""
        return twin.with_filter(self.sessions[0].bayer, self.characterisation.calibration.white)

    def evened(self, levels: LevelStack, black_level: float) -> LevelStack:
        """Give levels as if all pixels had the same colour, where neighbours are compared."""
        # levels (n, h, w)
        if self.mosaic is None:
            return levels
        black = np.float32(black_level * self.full_scale)
        return np.asarray((levels - black) / self.mosaic + black, np.float32)

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
        """Indices of the first image of every set that all LEDs light."""
        return tuple(
            index
            for index, (number, step, _) in enumerate(self.plan.steps())
            if step == 0 and self.plan.sets[number].one_led is None
        )

    @cached_property
    def finest_sets(self) -> tuple[int, ...]:
        """Indices of the finest fringes along each axis, or of the finest code where there are none."""
        plan, size = self.plan, self.projector[0]

        def fineness(index: int) -> tuple[bool, float]:
            length = axis_length(size, plan.sets[index].coded_axis or "x")
            return index in plan.fringe_indices, plan.sets[index].finest_stripes(length)

        along = ([k for k, each in enumerate(plan.sets) if each.coded_axis == axis] for axis in plan.axes)
        return tuple(max(indices, key=fineness) for indices in along)

    @cached_property
    def finest(self) -> tuple[int, ...]:
        """Two images of the finest set along each axis; of fringes a quarter of a period apart."""
        return tuple(
            index
            for number in self.finest_sets
            for images in [self._finest_first(number)]
            for index in (images[0], *images[max(1, round(len(images) / 4)) :][:1])
        )

    @cached_property
    def finest_spread(self) -> tuple[int, ...]:
        """Up to `finest_images` images of the finest set along every axis, of fringes evenly spaced."""
        images = []
        for number in self.finest_sets:
            ordered = self._finest_first(number)
            every = max(1, len(ordered) // LIMITS.finest_images)
            images += ordered[::every][: LIMITS.finest_images]
        return tuple(sorted(images))

    def _finest_first(self, index: int) -> list[int]:
        """Images of a set; of a code those first that change most along its axis."""
        plan, shown = self.plan, self.plan.sets[index]
        images = list(range(*plan.set_starts[index : index + 2]))
        if index in plan.fringe_indices:
            return images
        length = axis_length(self.projector[0], shown.coded_axis or "x")
        at, first = np.arange(length, dtype=np.float64), images[0]
        changes = [np.abs(np.diff(shown.light(step, at, length))).sum() for step in range(shown.images)]
        return sorted(images, key=lambda image: -changes[image - first])

    @cached_property
    def compared(self) -> tuple[int, ...]:
        """Images by which pixels of bench and twin are compared: the finest, and one of each set."""
        return tuple(sorted({*self.finest_spread, *self.one_of_each_set}))

    def shown(self, images: Sequence[int]) -> tuple[Pattern, ...]:
        return tuple(self.patterns[index] for index in images)

    def frames(self, pose: int, images: Sequence[int]) -> LevelStack:
        """Read some frames of a pose; their checksums are not verified."""
        # returns (n, h, w)
        return np.stack(
            [self.sessions[pose].read(self.compared_pass.first + i, verify=False) for i in images]
        ).astype(np.float32)

    def recorded(self, pose: int) -> list[Image]:
        """Read all frames of a pose as they were recorded; their checksums are not verified."""
        first = self.compared_pass.first
        return [self.sessions[pose].read(first + i, verify=False) for i in range(len(self.patterns))]

    def recording(self, pose: int, frames: Sequence[Image]) -> Recording:
        """Give frames of the compared exposure, the bench's or the twin's, for decoding."""
        session, (size, lattice) = self.sessions[pose], self.projector
        plan = self.plan.model_copy(update={"exposures_s": None, "exposure_s": self.settings.exposure_s})
        name, bits = session.path.name, self.settings.bits
        return Recording(frames, plan, size, bits, name, lattice=lattice, bayer=session.bayer)

    def spread_poses(self, count: int) -> tuple[int, ...]:
        """Choose poses that are evenly spread over the depths of the board."""
        depths = np.array([pose.translation[2] for pose in self.characterisation.poses])
        order = np.argsort(depths)
        chosen = np.rint(np.linspace(0, len(order) - 1, min(count, len(order)))).astype(int)
        return tuple(int(i) for i in order[chosen])
