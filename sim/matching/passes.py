"""What of a session a twin is compared with: the images of one exposure, or all of them merged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from fpplab.core.conventions import Image, full_scale
from fpplab.core.errors import ConfigError
from fpplab.devices import CameraSettings
from fpplab.patterns.fringes import Pattern
from fpplab.patterns.recording import Recording
from fpplab.phase.exposures import merged_recording
from fpplab.sessions.session import Session

MAX_SATURATED = 0.01
"""Share of the levels of a pass that may be saturated where a shorter one has fewer (chosen)."""


@dataclass(frozen=True)
class ComparedPass:
    """The pass of a session with whose images those of a twin are compared."""

    first: int  # number of its first frame in the session
    settings: CameraSettings  # with which it was taken

    @classmethod
    def of(cls, session: Session) -> ComparedPass:
        """Choose the longest exposure that saturates hardly anything."""
        plan, records = session.plan, session.records
        starts = zip(plan.pass_starts, plan.passes, strict=False)
        passes = [
            cls(first, records[first].settings) for first, images in starts if len(images) == plan.images
        ]
        if not passes:
            raise ConfigError(
                f"{session.path}: no exposure takes every image of the plan, and images of one exposure are "
                "compared with a twin's; give all sets an exposure in common"
            )
        passes.sort(key=lambda each: each.settings.exposure_s)
        while len(passes) > 1 and passes[-1].saturated_share(session) > MAX_SATURATED:
            passes.pop()
        return passes[-1]

    def saturated_share(self, session: Session) -> float:
        full, images = full_scale(self.settings.bits), range(self.first, self.first + session.plan.images)
        return float(np.mean([np.mean(session.read(i, verify=False) >= full) for i in images]))


def twin_recording(
    session: Session,
    patterns: Sequence[Pattern],
    take: Callable[[Sequence[Pattern], CameraSettings], list[Image]],
    name: str,
) -> Recording:
    """Give a twin's frames of the plan and the settings of a session, merged as the session's are."""
    plan, (size, lattice) = session.plan, session.projector()
    settings = [session.records[first].settings for first in plan.pass_starts[:-1]]
    frames = [
        frame
        for images, each in zip(plan.passes, settings, strict=True)
        for frame in take([patterns[i] for i in images], each)
    ]
    raw = Recording(frames, plan, size, settings[0].bits, name, lattice=lattice, bayer=session.bayer)
    return merged_recording(raw, [each.exposure_s for each in settings])
