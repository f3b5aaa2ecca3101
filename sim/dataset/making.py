"""Makes a data set on a rig with a simulation: scene by scene, captured with the rig's own devices."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from fpplab.acquisition.acquire import expose
from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.conventions import Image, axis_length, phase_of_coordinate
from fpplab.core.disk_space import disk_bytes, need_space
from fpplab.core.errors import ConfigError
from fpplab.core.progress import Progress, no_progress
from fpplab.devices.backends import load_backend
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.mosaic import Bayer
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import check_codes, check_unwrapping, decode, wrapped_phase
from fpplab.phase.exposures import merged_recording
from fpplab.pipeline.true_maps import TrueMaps, trace_true_maps
from sim.bench import VirtualBench
from sim.dataset.card import dataset_fields, make_card, prepare_folder, split_of
from sim.dataset.scenes import SceneRanges, draw_scene, draw_stage
from sim.dataset.shard import (
    FRAMES,
    Arrays,
    ShardWriter,
    check_shard,
    claim_shard,
    dimension_sizes,
    draft_name,
    shard_name,
)
from sim.studio import DatasetScene

SampleObserver = Callable[[Arrays, dict[str, Any]], object]
"""Called with the arrays and the record of each sample once it is written."""


def sample_arrays(
    frames: list[Image],
    plan: Plan,
    exposure_s: float,
    bits: int,
    devices: Calibration,
    labels: TrueMaps,
    bayer: Bayer | None = None,
) -> Arrays:
    """Compute every field of a sample, as `FIELDS` describes them."""
    # frames (height, width)
    size, lattice = devices.projector.size, devices.projector.lattice
    raw = Recording(frames, plan, size, bits, lattice=lattice, bayer=bayer)
    recording = merged_recording(raw, plan.exposures)
    decoded = decode(recording)
    fringes = plan.fringe_part.fringes if plan.fringe_part else ()
    wrapped = [
        wrapped_phase(recording.of_set(index), fringe).phase
        for index, fringe in zip(plan.fringe_indices, fringes, strict=True)
    ]
    coordinates = {"x": labels.u, "y": labels.v}
    absolute = [
        phase_of_coordinate(coordinates[f.axis].astype(np.float64), f.stripes, axis_length(size, f.axis))
        for f in fringes
    ]
    phases: Arrays = {"wrapped_phase": np.array(wrapped), "absolute_phase": np.array(absolute, np.float32)}
    return (phases if fringes else {}) | {
        FRAMES: np.stack(frames),
        "exposure_s": np.array(exposure_s),
        "decoded_u": decoded.u,
        "decoded_v": decoded.v,
        "decoded_sigma": decoded.sigma,
        "modulation": decoded.modulation,
        "projector_u": labels.u,
        "projector_v": labels.v,
        "depth": labels.depth,
        "normals": labels.normals,
        "mask": labels.mask,
        "camera_matrix": devices.camera.matrix,
        "camera_distortion": devices.camera.distortion,
        "projector_matrix": devices.projector.matrix,
        "projector_distortion": devices.projector.distortion,
        "T_projector_camera": devices.T_projector_camera.matrix,
    }


def _unobserved(arrays: Arrays, record: dict[str, Any]) -> None:
    """Observe nothing."""


@dataclass(frozen=True)
class DatasetRequest:
    """What the samples of a data set follow from, besides the rig."""

    plan: Plan  # what is projected
    scenes: SceneRanges  # ranges that scenes are drawn from
    samples: int  # number of samples, at least 1
    seed: int = 0  # at least 0; another seed gives other scenes
    shard_size: int = 8  # samples in a shard, at least 1

    def shard(self, number: int) -> range:
        return range(number * self.shard_size, min((number + 1) * self.shard_size, self.samples))


class DatasetMaker:
    """Makes the samples of a data set on an open rig that is a simulation, in any order."""

    def __init__(self, rig: Rig, request: DatasetRequest) -> None:
        caps = rig.projector.caps
        check_unwrapping(request.plan, "plan")
        check_codes(request.plan, caps.size, "plan")
        request.plan.refuse_set_exposures("a data set")
        self._patterns = make_patterns(request.plan, caps.size, caps.lattice)
        _check_ranges(rig, request.plan, request.scenes)
        self._rig, self._request = rig, request
        self._studio = _arrangeable(rig).studio()
        self._bits = rig.camera_settings(request.plan.exposure_s, request.plan.bits).bits
        self._dimensions = dimension_sizes(request.plan, rig.camera.caps.size)
        self._fields = dataset_fields(self._bits, self._dimensions)
        if rig.stage is not None:
            rig.stage.home()

    def card(self) -> dict[str, Any]:
        request = self._request
        recipe = {
            "samples": request.samples,
            "shard_size": request.shard_size,
            "seed": request.seed,
            "plan": config.plain(request.plan),
            "scenes": request.scenes.model_dump(mode="json", exclude={"licence"}),
            "rig": self._rig.described(),
            "world": self._studio.nominal(),
        }
        return make_card(recipe, self._fields, self._dimensions, request.scenes.licence)

    def make(
        self, folder: Path, progress: Progress = no_progress, observe: SampleObserver = _unobserved
    ) -> dict[str, Any]:
        """Make every shard that is missing."""
        # Existing shards are checked; one that another process is making is left to it. An interrupted data
        # set is completed by the same call, with the same result as without the interruption.
        card, request = self.card(), self._request
        missing = [n for n in range(card["shards"]) if not (folder / shard_name(n)).exists()]
        samples = sum(len(request.shard(number)) for number in missing)
        drafts = sum(disk_bytes(folder / draft_name(number)) for number in missing)
        need_space(folder, samples * card["bytes_per_sample"], f"{samples} samples", drafts)
        prepare_folder(folder, card)
        for number in range(card["shards"]):
            if (folder / shard_name(number)).exists():
                check_shard(folder / shard_name(number))
            else:
                self._shard(folder, number, lambda index: progress(index / request.samples), observe)
            progress(request.shard(number).stop / request.samples)
        return card

    def _shard(
        self, folder: Path, number: int, begun: Callable[[int], None], observe: SampleObserver
    ) -> None:
        samples = self._request.shard(number)
        with claim_shard(folder, number) as draft:
            if draft is None:
                return
            with ShardWriter(draft, self._fields, len(samples), self._dimensions) as shard:
                for index in samples:
                    begun(index)
                    arrays, record = self.sample(index)
                    shard.add(arrays, record)
                    observe(arrays, record)

    def sample(self, index: int) -> tuple[Arrays, dict[str, Any]]:
        """Make one sample; it does not depend on the samples made before."""
        request, studio = self._request, self._studio
        scene = self._draw_scene(index)
        studio.arrange(scene)
        frames = self._frames(scene)
        mesh, devices = studio.truth()
        labels = trace_true_maps(mesh, devices)
        bayer = self._rig.camera.caps.bayer
        arrays = sample_arrays(frames, request.plan, scene.exposure_s, self._bits, devices, labels, bayer)
        record = {
            "index": index,
            "split": split_of(index),
            "scene": config.plain(scene),
            "world": studio.world(),
        }
        return arrays, record

    def _draw_scene(self, index: int) -> DatasetScene:
        request = self._request
        stage_mm = draw_stage(request.scenes, request.seed, index)
        return draw_scene(request.scenes, request.seed, index, self._studio.calibration(stage_mm), stage_mm)

    def _frames(self, scene: DatasetScene) -> list[Image]:
        rig, plan = self._rig, self._request.plan
        if rig.stage is not None:
            rig.stage.move_to(scene.stage_mm)
        # Noise numbers count from the camera's opening: reopened, a sample is independent of those before.
        rig.camera.close()
        rig.camera.open()
        frames = list[Image]()
        for exposure_s in plan.exposures:
            settings = rig.camera_settings(scene.exposure_s * exposure_s / plan.exposure_s, self._bits)
            with closing(expose(rig, self._patterns, settings, plan)) as shots:
                frames += [shot.image for shot in shots]
        return frames


def _check_ranges(rig: Rig, plan: Plan, scenes: SceneRanges) -> None:
    """Refuse ranges that the devices cannot do, before the first scene: `ConfigError`."""
    travel = rig.stage.caps.travel_mm if rig.stage is not None else (0.0, 0.0)
    limits = {
        "exposure_s": (rig.camera.caps.exposure_s, "the camera's exposure"),
        "stage_mm": (travel, "the stage's travel" if rig.stage is not None else "a rig without a stage"),
    }
    for name, ((lower, upper), what) in limits.items():
        low, high = getattr(scenes, name)
        if name == "exposure_s":  # of which a plan's exposures are multiples
            low *= min(plan.exposures) / plan.exposure_s
            high *= max(plan.exposures) / plan.exposure_s
        if not lower <= low <= high <= upper:
            raise ConfigError(
                f"scenes: '{name}' is [{low:g}, {high:g}]: outside {what}, {lower:g} to {upper:g}"
            )


def need_simulation(rig: Rig, source: Path | str) -> None:
    """Refuse a rig, open or not, whose scene cannot be arranged."""
    section = rig.file.bench
    if section is None or not issubclass(load_backend(section.backend, source, "bench"), VirtualBench):
        raise ConfigError(
            f"{source}: its bench is no simulation, and only a simulation knows what is true of its frames; "
            "name a rig such as rig_demo"
        )


def _arrangeable(rig: Rig) -> VirtualBench:
    if not isinstance(rig.simulation, VirtualBench):
        raise ConfigError(f"{rig.file.name}: its scene cannot be arranged; name a rig such as rig_demo")
    return rig.simulation
