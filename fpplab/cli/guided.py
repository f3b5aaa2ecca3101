"""`fpplab characterise --guide`: its options, and what it prints."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from fpplab.cli import console
from fpplab.core.errors import ConfigError
from fpplab.core.units import length_mm

if TYPE_CHECKING:
    from fpplab.acquisition.acquire import FrameObserver
    from fpplab.characterisation import DistortionModel
    from fpplab.core.depth import DepthInterval
    from fpplab.devices.rig import Rig
    from fpplab.patterns.plan import Plan
    from fpplab.setup.guide import GuidedRun
    from fpplab.targets import Target


def wanted_mm(
    guide: bool, until: str | None, depth_mm: DepthInterval | None, rig: str | None
) -> float | None:
    """Check the options that go with one another."""
    for option, value in (("--until", until), ("--depth", depth_mm)):
        if value is not None and not guide:
            raise ConfigError(f"{option} goes with --guide, which asks for poses; add --guide")
    if guide and rig is None:
        raise ConfigError("--guide takes poses one at a time, and needs --rig to take them on")
    if depth_mm is not None and not 0 < depth_mm[0] < depth_mm[1]:
        raise ConfigError(
            f"--depth is {depth_mm[0]:g} {depth_mm[1]:g}: must be two rising positive distances in mm"
        )
    return None if until is None else length_mm(until, "--until")


def run_guided(
    rig: Rig,
    plan: Plan,
    target: Target,
    folder: Path,
    level: DistortionModel | Literal["auto"],
    refine_board: bool | None,
    force: bool,
    *,
    item: str,
    poses: int,
    until_mm: float | None,
    depth_mm: DepthInterval | None,
    observe_frame: FrameObserver,
) -> GuidedRun:
    """Characterise a rig by poses asked for one at a time, and tell of each on stderr."""
    from fpplab.setup.guide import GuidedSettings, guided_characterisation

    depth = depth_mm or plan.depth_mm or rig.file.depth_mm
    settings = GuidedSettings(item, poses, until_mm, depth, level, refine_board is not False, force)
    return guided_characterisation(
        rig, plan, target, folder, settings, console.log_status, console.progress, observe_frame
    )
