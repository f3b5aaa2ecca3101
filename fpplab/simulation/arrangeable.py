"""What a data set asks of a simulation: any scene, and everything that is true of it.

A rig's `bench` that can do so gives it by `bench.studio()`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import trimesh

from fpplab.calibration.model import Calibration
from fpplab.core.errors import ConfigError
from fpplab.dataset.scenes import DatasetScene
from fpplab.devices.rig import Rig, load_backend


@dataclass(frozen=True, eq=False)
class SceneTruth:
    """What stands before the camera. mesh: in mm in the camera's frame; flat ones have two sides.

    calibration: the true devices, with the stage where it is.
    """

    mesh: trimesh.Trimesh
    calibration: Calibration


class Arrangeable(Protocol):
    """A simulation that takes any scene. Raises `ConfigError` for one that it cannot have."""

    def nominal(self) -> dict[str, Any]:
        """What all scenes share: the world that they are variations of, as plain data."""
        ...

    def calibration(self, stage_mm: float) -> Calibration:
        """The true devices with the stage at `stage_mm`."""
        ...

    def arrange(self, scene: DatasetScene) -> None:
        """Stand the scene's item before the devices, in the scene's light. The stage moves as a device."""
        ...

    def world(self) -> dict[str, Any]:
        """The world as it is arranged, as plain data."""
        ...

    def truth(self) -> SceneTruth:
        """What stands there."""
        ...


def need_simulation(rig: Rig, source: Path | str) -> None:
    """Refuse a rig, open or not, whose bench has no studio: `ConfigError`."""
    bench = rig.file.bench
    if bench is None or not hasattr(load_backend(bench.backend, source, "bench"), "studio"):
        raise ConfigError(
            f"{source}: its bench is no simulation, and only a simulation knows what is true of its frames; "
            "name a rig such as rig_demo"
        )
