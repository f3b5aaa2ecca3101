"""A twin that tells when it is used, so that steps of a matching report how far they are and can be ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import cast

import trimesh

from fpplab.core.conventions import Image, PixelIndices
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern
from fpplab.targets import Target
from sim.appearance import Appearance
from sim.parameters import TwinParameters
from sim.twin import ExpectedLevels, Twin


def watched_twin(twin: Twin, watch: Callable[[], None]) -> Twin:
    """Wrap a twin to call a function before it computes images of its board."""
    return cast(Twin, _WatchedTwin(twin, watch))


class _WatchedTwin:
    def __init__(self, twin: Twin, watch: Callable[[], None]) -> None:
        self._twin, self._watch = twin, watch

    @property
    def parameters(self) -> TwinParameters:
        return self._twin.parameters

    @property
    def target(self) -> Target:
        return self._twin.target

    @property
    def next_frame(self) -> int:
        return self._twin.next_frame

    def count_frames_from(self, number: int) -> None:
        self._twin.count_frames_from(number)

    def become(self, parameters: TwinParameters) -> None:
        self._twin.become(parameters)

    def expected(self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings) -> ExpectedLevels:
        self._watch()
        return self._twin.expected(pose, patterns, settings)

    def expected_at(
        self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings, pixels: PixelIndices
    ) -> ExpectedLevels:
        self._watch()
        return self._twin.expected_at(pose, patterns, settings, pixels)

    def expected_with_slopes(
        self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings, pixels: PixelIndices
    ) -> tuple[ExpectedLevels, ExpectedLevels] | None:
        self._watch()
        return self._twin.expected_with_slopes(pose, patterns, settings, pixels)

    def frames(self, pose: int, patterns: Sequence[Pattern], settings: CameraSettings) -> list[Image]:
        self._watch()
        return self._twin.frames(pose, patterns, settings)

    def expected_of(self, item: str, patterns: Sequence[Pattern], settings: CameraSettings) -> ExpectedLevels:
        return self._twin.expected_of(item, patterns, settings)

    def expected_part(
        self,
        item: str,
        pose: RigidTransform,
        patterns: Sequence[Pattern],
        settings: CameraSettings,
        pixels: PixelIndices,
    ) -> ExpectedLevels:
        self._watch()
        return self._twin.expected_part(item, pose, patterns, settings, pixels)

    def scan(
        self, item: str, pose: RigidTransform, patterns: Sequence[Pattern], settings: CameraSettings
    ) -> list[Image]:
        return self._twin.scan(item, pose, patterns, settings)

    def mesh(self, item: str) -> trimesh.Trimesh:
        return self._twin.mesh(item)

    def pose_of(self, item: str) -> RigidTransform:
        return self._twin.pose_of(item)

    def appear(self, appearance: Appearance) -> None:
        self._twin.appear(appearance)

    def save(self, folder: Path, notes: Sequence[str] = ()) -> Path:
        return self._twin.save(folder, notes)
