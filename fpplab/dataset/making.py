"""A data set from a rig with a simulation: scene by scene, through the rig's own devices."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fpplab.acquisition.acquire import expose
from fpplab.core import config
from fpplab.core.conventions import Image
from fpplab.core.errors import ConfigError
from fpplab.core.progress import Progress, no_progress
from fpplab.dataset.arrays import sample_arrays
from fpplab.dataset.card import dataset_fields, make_card, prepare_folder, split_of
from fpplab.dataset.fields import Arrays, dimension_sizes
from fpplab.dataset.labels import trace_labels
from fpplab.dataset.scenes import SceneRanges, draw_scene, draw_stage
from fpplab.dataset.shard import ShardWriter, check_shard, claim_shard, shard_name
from fpplab.devices.rig import Rig, load_backend
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from fpplab.phase import check_unwrapping
from fpplab.simulation.arrangeable import Arrangeable
from fpplab.simulation.scene import DatasetScene


@dataclass(frozen=True)
class DatasetRequest:
    """What a data set follows from beside the rig: nothing else changes a sample.

    samples, shard_size: at least 1. seed: at least 0.
    """

    plan: Plan
    scenes: SceneRanges
    samples: int
    seed: int = 0
    shard_size: int = 8

    def shard(self, number: int) -> range:
        """The samples of a shard."""
        return range(number * self.shard_size, min((number + 1) * self.shard_size, self.samples))


class DatasetMaker:
    """Makes the samples of a data set on an open rig that is a simulation, in any order.

    Raises `ConfigError` for a plan or for scenes that the rig cannot have.
    """

    def __init__(self, rig: Rig, wanted: DatasetRequest) -> None:
        check_unwrapping(wanted.plan, "plan")
        caps = rig.projector.caps
        self._patterns = make_patterns(wanted.plan, caps.size, caps.lattice)
        _check_ranges(rig, wanted.scenes)
        self._rig, self._wanted = rig, wanted
        self._studio = _arrangeable(rig).studio()
        self._fields = dataset_fields(rig.file.camera.bits)
        self._dimensions = dimension_sizes(wanted.plan, rig.camera.caps.size)
        if rig.stage is not None:
            rig.stage.home()

    def card(self) -> dict[str, Any]:
        """The data set's card."""
        wanted = self._wanted
        asked = {
            "samples": wanted.samples,
            "shard_size": wanted.shard_size,
            "seed": wanted.seed,
            "plan": config.plain(wanted.plan),
            "scenes": wanted.scenes.model_dump(mode="json", exclude={"licence"}),
            "rig": self._rig.described(),
            "world": self._studio.nominal(),
        }
        return make_card(asked, self._fields, self._dimensions, wanted.scenes.licence)

    def make(self, folder: Path, progress: Progress = no_progress) -> dict[str, Any]:
        """Make every shard that is missing in `folder`, and return the card.

        Shards that are there are checked; one that another process is at is left to it. An interrupted data
        set goes on by the same call, and ends as if nothing had happened.
        Raises `ConfigError` when the folder holds something else, `DataError` when a shard is damaged or the
        disk is full, `DeviceError`.
        """
        card, wanted = self.card(), self._wanted
        prepare_folder(folder, card)
        for number in range(card["shards"]):
            if (folder / shard_name(number)).exists():
                check_shard(folder / shard_name(number))
            else:
                self._shard(folder, number, lambda index: progress(index / wanted.samples))
            progress(wanted.shard(number).stop / wanted.samples)
        return card

    def _shard(self, folder: Path, number: int, begun: Callable[[int], None]) -> None:
        samples = self._wanted.shard(number)
        with claim_shard(folder, number) as draft:
            if draft is None:
                return
            with ShardWriter(draft, self._fields, len(samples), self._dimensions) as shard:
                for index in samples:
                    begun(index)
                    shard.add(*self.sample(index))

    def sample(self, index: int) -> tuple[Arrays, dict[str, Any]]:
        """All arrays of one sample, and what was drawn for it."""
        wanted, studio = self._wanted, self._studio
        scene = self._scene(index)
        studio.arrange(scene)
        frames = self._frames(scene)
        truth = studio.truth()
        bits = self._rig.file.camera.bits
        arrays = sample_arrays(frames, wanted.plan, scene.exposure_s, bits, truth, trace_labels(truth))
        record = {
            "index": index,
            "split": split_of(index),
            "scene": config.plain(scene),
            "world": studio.world(),
        }
        return arrays, record

    def _scene(self, index: int) -> DatasetScene:
        wanted = self._wanted
        stage_mm = draw_stage(wanted.scenes, wanted.seed, index)
        return draw_scene(wanted.scenes, wanted.seed, index, self._studio.calibration(stage_mm), stage_mm)

    def _frames(self, scene: DatasetScene) -> list[Image]:
        rig, plan = self._rig, self._wanted.plan
        if rig.stage is not None:
            rig.stage.move_to(scene.stage_mm)
        # Noise counts from the camera's opening, so that a sample does not depend on those before it.
        rig.camera.close()
        rig.camera.open()
        with closing(expose(rig, self._patterns, rig.camera_settings(scene.exposure_s), plan)) as shots:
            return [shot.image for shot in shots]


def _check_ranges(rig: Rig, scenes: SceneRanges) -> None:
    """Refuse what the devices cannot do, before the first scene: `ConfigError`."""
    travel = rig.stage.caps.travel_mm if rig.stage is not None else (0.0, 0.0)
    limits = {
        "exposure_s": (rig.camera.caps.exposure_s, "the camera's exposure"),
        "stage_mm": (travel, "the stage's travel" if rig.stage is not None else "a rig without a stage"),
    }
    for name, ((least, most), what) in limits.items():
        low, high = getattr(scenes, name)
        if not least <= low <= high <= most:
            raise ConfigError(
                f"scenes: '{name}' is [{low:g}, {high:g}]: outside {what}, {least:g} to {most:g}"
            )


def need_simulation(rig: Rig, source: Path | str) -> None:
    """Refuse a rig, open or not, whose scene cannot be arranged.

    Parameters
    ----------
    rig : Rig
        Open or not: its rig file is looked at.
    source : path or str
        What the rig is called in the message.

    Raises
    ------
    ConfigError
        The rig's simulation is missing or is not `Arrangeable`.
    """
    section = rig.file.bench
    if section is None or not issubclass(load_backend(section.backend, source, "bench"), Arrangeable):
        raise ConfigError(
            f"{source}: its bench is no simulation, and only a simulation knows what is true of its frames; "
            "name a rig such as rig_demo"
        )


def _arrangeable(rig: Rig) -> Arrangeable:
    if not isinstance(rig.simulation, Arrangeable):
        raise ConfigError(f"{rig.file.name}: its scene cannot be arranged; name a rig such as rig_demo")
    return rig.simulation
