"""A hidden bench at work: recordings of its board, card and parts, frame by frame with all effects."""

import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden.effects import Effects, drawn_effects
from benchmarks.hidden.foreign import Foreign, drawn_foreign
from benchmarks.hidden.light import HiddenLight
from benchmarks.hidden.worlds import BOARD, CARD, drawn_world
from benchmarks.virtual import virtual_bench
from fpplab.calibration.model import Calibration
from fpplab.core import config
from fpplab.core.conventions import Floats, Image
from fpplab.core.files import write_text
from fpplab.devices import CameraSettings, Frame
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import Pattern, make_patterns
from fpplab.patterns.plan import Plan
from fpplab.patterns.response import Response
from fpplab.pipeline.response import measure_response
from fpplab.sessions.session import Session
from sim.build import SceneState
from sim.items import item_poses
from sim.light import PatternLevels, ShownPattern
from sim.sensor import SensorModel
from sim.world import World

MAINS_HZ = 50.0
FRAME_S = 0.05
"""From frame to frame."""


@dataclass(eq=False)
class HiddenBench:
    """An open hidden bench."""

    rig: Rig  # of the world, with the light of the effects
    world: World  # the truth
    effects: Effects  # the truth beyond it
    light: HiddenLight  # of both
    foreign: Foreign  # the truth that no twin can have
    frames: int = field(default=0)  # recorded so far: noise and all that changes with time follow from it

    def response(self, exposure_s: float) -> Response:
        """Measure the response on the card."""
        self.rig.need_fixture("the benchmark").mount(CARD, 0)
        return measure_response(self.rig, exposure_s)[0]

    def board(self, plan: Plan, folder: Path) -> list[Session]:
        """Record all poses of the board."""
        poses = range(len(item_poses(self.world, BOARD)))
        return [self.record(plan, folder / f"pose_{pose:02d}", BOARD, pose) for pose in poses]

    def record(self, plan: Plan, path: Path, item: str, pose: int = 0) -> Session:
        """Record a plan on an item."""
        return record_images(self.rig, plan, path, (item, pose), partial(self._images, item, pose))

    def _images(
        self, item: str, pose: int, patterns: tuple[Pattern, ...], settings: CameraSettings
    ) -> Iterator[Image]:
        held, sensor = item_poses(self.world, item)[pose], SensorModel.of(self.world)
        still = SceneState(item, held=held)
        moved = SceneState(item, held=held.moved(np.array(self.effects.shaking.mm)))
        dark, lamp = self.light.irradiance(still, None), self.light.lamp(still)
        rows = np.arange(self.world.camera.size[1])[:, None]
        # A set-up at a time, since its surfaces are kept until the next.
        at_rest, displaced = (self._under_patterns(setup, patterns) for setup in (still, moved))
        for n in range(len(patterns)):
            random = np.random.default_rng([self.effects.seed, 4, self.frames])
            step = self._displacement(random)
            seen = (1.0 - step) * at_rest[n] + step * displaced[n]
            flicker = 1.0 + self.effects.flicker * random.standard_normal()
            flicker *= 1.0 - self.foreign.dimming * self.foreign.passed(self.frames)
            ripple = self._ripple(rows)
            picture = self.foreign.seen(dark + lamp * ripple + flicker * (seen - dark))
            irradiance = np.maximum(picture, 0.0).astype(np.float32)
            yield sensor.expose(irradiance, settings, self.frames)
            self.frames += 1

    def _under_patterns(self, setup: SceneState, patterns: tuple[Pattern, ...]) -> list[PatternLevels]:
        """What the camera sees under every pattern, while the projector drifts from the first to the last."""
        shares = self.foreign.span(self.frames, len(patterns))
        early, late = (self._light_after(share) for share in shares)
        shown = [ShownPattern(patterns, n) for n in range(len(patterns))]
        seen = [early.irradiance(setup, show) for show in shown]
        if shares[0] == shares[1]:
            return seen
        weights = np.linspace(0.0, 1.0, len(patterns), dtype=np.float32)
        return [
            (1 - weight) * before + weight * late.irradiance(setup, show)
            for weight, before, show in zip(weights, seen, shown, strict=True)
        ]

    def _light_after(self, share: float) -> HiddenLight:
        """Light of the world as the projector's drift has changed it by a share of its way."""
        world = self.foreign.world(self.world, share)
        if world == self.world:
            return self.light
        return HiddenLight(world, virtual_bench(self.rig).blender, self.effects, self.foreign)

    def calibration_of_board(self, images: int) -> Calibration:
        """Give the geometry, in the mean of the poses of the board, which were recorded first."""
        count = len(item_poses(self.world, BOARD))
        shares = [self.foreign.span(images * pose, images) for pose in range(count)]
        world = self.foreign.world(self.world, float(np.mean(shares)))
        return Calibration(world.camera_model(), world.projector_model(), world.T_projector_camera(), {})

    def _displacement(self, random: np.random.Generator) -> float:
        """Of a frame, in units of the standard deviation."""
        shaking = self.effects.shaking
        wave = np.sqrt(2.0) * np.sin(2 * np.pi * shaking.hz * FRAME_S * self.frames)
        alone = random.standard_normal()
        return float(np.sqrt(shaking.periodic) * wave + np.sqrt(1.0 - shaking.periodic) * alone)

    def _ripple(self, rows: NDArray[np.int64]) -> Floats:
        """Relative change (height, 1) of the second lamp's light in a frame."""
        lamp = self.effects.lamp
        # frames are not in step with the mains: the phase drifts by a tenth of a period for each
        phase = 2 * np.pi * (2 * MAINS_HZ * lamp.line_time_s * rows + 0.1 * self.frames)
        return np.asarray(lamp.ripple * np.sin(phase))


def record_images(
    rig: Rig,
    plan: Plan,
    path: Path,
    mount: tuple[str, int],
    images: Callable[[tuple[Pattern, ...], CameraSettings], Iterable[Image]],
) -> Session:
    """Record images of a plan that the rig's own camera does not take."""
    caps, settings = rig.projector.caps, rig.camera_settings(plan.exposure_s, plan.bits)
    patterns = tuple(make_patterns(plan, caps.size, caps.lattice))
    session = Session.create(path, plan, rig.described(mount), force=True)
    for index, image in enumerate(images(patterns, settings)):
        session.write(Frame(image, index, settings, time.time(), pattern_id=patterns[index].id))
    return session


@contextmanager
def hidden_bench(
    seed: int, folder: Path, poses: int = 12, binning: int = 8, kind: str | None = None
) -> Iterator[HiddenBench]:
    """Draw and open a hidden bench, with one of the kinds of foreign effects."""
    world, effects = drawn_world(seed, poses, binning), drawn_effects(seed)
    foreign = drawn_foreign(kind, seed) if kind else Foreign()
    path = write_rig(world, folder, "Hidden bench")
    with Rig.load(path) as rig:
        bench = virtual_bench(rig)
        light = HiddenLight(world, bench.blender, effects, foreign)
        bench.light = light
        yield HiddenBench(rig, world, effects, light, foreign)


def write_rig(world: World, folder: Path, name: str) -> Path:
    """Write a world and a rig file of it."""
    world.save(folder)
    path = config.find_config("rig_hidden", "rig")
    data = config.parse_yaml(config.read_text(path), path)
    data |= {"name": name}
    data["bench"] |= {"world": "world.yaml"}
    write_text(folder / "rig.yaml", config.to_yaml(data))
    return folder / "rig.yaml"
