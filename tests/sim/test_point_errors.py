"""Errors of a board's points in each pose: in the table of light, in frames, and as a matching finds them."""

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from fpplab.characterisation import Characterisation, Observation, characterise, finest_periods, observe
from fpplab.core.geometry import RigidTransform
from fpplab.devices import CameraSettings
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from sim.build import SceneState
from sim.effects.point_errors import BoardPointErrors, PointErrorsParameters
from sim.fluctuation import displaced
from sim.items import item_poses
from sim.light import Light
from sim.light.point_errors import error_draw
from sim.light.table import LightTable
from sim.matching.evaluation import reprojection_errors
from sim.parameters import TwinParameters
from sim.twin import Twin
from sim.worker import Blender
from sim.world import World
from tests.sim.conftest import world

POINTS_PX, POSES_PX = (0.05, 0.08), (0.02, 0.03)
SETTINGS = CameraSettings(0.02, bits=12)
PLAN = Plan(
    fringes=tuple(
        Sinusoid(axis=axis, stripes=stripes, steps=steps)
        for axis in ("x", "y")
        for stripes, steps in ((1, 3), (8, 3), (64, 6))
    )
)


def table(of: World, pose: int = 0, has_point_errors: bool = True) -> LightTable:
    light, draw = Light(of, Blender("bench"), analytic=True), error_draw(item_poses(of, "board")[pose])
    return light.table(SceneState("board", pose, error_draw=draw if has_point_errors else None))


def test_samples_are_displaced_by_as_much_as_the_world_says() -> None:
    erring = world(point_errors={"points_px": (0.0, 0.0), "poses_px": (0.0, 0.05)})
    exact = table(erring, has_point_errors=False)
    off = np.concatenate(
        [
            (there.samples - plain.samples)[plain.samples[..., 3] > 0][:, 0]
            for there, plain in ((table(erring, n), table(erring, n, False)) for n in range(4))
        ]
    )
    # Six functions of mean square 1 over the board, each of that size.
    assert np.sqrt(np.mean(off**2)) == pytest.approx(np.sqrt(6) * 0.05, rel=0.5)
    np.testing.assert_array_equal(table(erring).samples, table(erring).samples)
    np.testing.assert_array_equal(exact.samples, table(world()).samples)


def test_the_camera_sees_another_place() -> None:
    """A pixel sees what its neighbour saw: by one slope of the projector's columns."""
    erring = world(point_errors={"points_px": (0.0, 0.0), "poses_px": (0.05, 0.0)})
    moved, exact = table(erring), table(erring, has_point_errors=False)
    inner = (slice(None), slice(20, -20), slice(20, -20))
    off, slope = (moved.samples - exact.samples)[inner], np.gradient(exact.samples[inner], axis=2)
    lit = exact.samples[inner][..., 3] > 0
    assert 0.02 < np.sqrt(np.mean((off[lit][:, 0] / slope[lit][:, 0]) ** 2)) < 0.5


def test_expected_images_have_no_errors_of_points() -> None:
    twin = Twin.of(world(point_errors={"points_px": POINTS_PX}), "board", Blender("bench"))
    plain = Twin.of(world(), "board", Blender("bench"))
    patterns = make_patterns(PLAN, twin.parameters.calibration.projector.size, twin.world.projector.lattice)
    np.testing.assert_array_equal(twin.expected(0, patterns, SETTINGS), plain.expected(0, patterns, SETTINGS))
    assert (twin.frames(0, patterns[:1], SETTINGS)[0] != plain.frames(0, patterns[:1], SETTINGS)[0]).any()


def test_displaced_boards_have_the_errors_of_the_board_at_rest() -> None:
    """Frames of a vibrating board are put together from pictures at displaced places."""
    erring = world(point_errors={"poses_px": (0.0, 0.05)})
    light, pose = Light(erring, Blender("bench"), analytic=True), item_poses(erring, "board")[0]
    still = SceneState("board", error_draw=error_draw(pose))
    (moved, *_) = displaced(still, pose, 1e-3)
    off = light.table(moved).samples - light.table(still).samples
    assert np.abs(off[..., :2]).max() < 0.02  # px of the projector: nothing near the errors' 0.1


def test_errors_are_those_of_about_the_same_place() -> None:
    pose = RigidTransform.from_vectors(np.array([1e-4, -1e-4, 0.2]), np.array([1e-3, 52.0, 448.0]))
    back = RigidTransform.from_vectors(np.array([-1e-4, 1e-4, 0.201]), np.array([-0.3, 52.2, 447.9]))
    assert error_draw(back) == error_draw(pose)
    assert error_draw(pose.moved(np.array([0.0, 0.0, 20.0]))) != error_draw(pose)
    turned = RigidTransform.from_vectors(np.array([0.0, 0.3, 0.2]), pose.translation)
    assert error_draw(turned) != error_draw(pose)


def characterised(twin: Twin) -> Characterisation:
    """Characterise a twin by its own frames."""
    size, observations = twin.parameters.calibration.projector.size, []
    lattice, target = twin.world.projector.lattice, twin.target
    for pose in range(len(twin.parameters.poses)):
        frames = twin.frames(pose, make_patterns(PLAN, size, lattice), SETTINGS)
        recording = Recording(frames, PLAN, size, SETTINGS.bits, f"pose {pose}")
        observations.append(observed(recording, twin, pose))
    camera = twin.parameters.calibration.camera.size
    return characterise(observations, target, camera, size, lattice)


def observed(recording: Recording, twin: Twin, pose: int) -> Observation:
    periods = finest_periods(PLAN, twin.parameters.calibration.projector.size)
    return observe(f"pose {pose}", recording.mean_image(), decode(recording), twin.target, periods)


@dataclass(frozen=True)
class Context:
    """What the step is given of a matching."""

    bench: Characterisation
    twin: Twin

    @property
    def parameters(self) -> TwinParameters:
        return self.twin.parameters

    def with_parameters(self, parameters: TwinParameters) -> "Context":
        return replace(self, twin=self.twin.with_parameters(parameters))

    def reprojection_errors(self) -> tuple[Any, Any]:
        return reprojection_errors(self.bench), reprojection_errors(characterised(self.twin))


@pytest.mark.whole
def test_a_matching_finds_how_large_they_are() -> None:
    exact = Twin.of(World.load("world_demo").binned(8), "board", Blender("bench"))
    exact = exact.with_parameters(replace(exact.parameters, poses=exact.parameters.poses[:5]))
    errors = PointErrorsParameters(point_errors_px=POINTS_PX, pose_errors_px=POSES_PX)
    erring = exact.with_parameters(exact.parameters.with_effect(errors))
    bench, effect = characterised(erring), BoardPointErrors()
    matched = effect.propose(cast(Any, Context(bench, exact)))
    assert matched.point_errors_px == pytest.approx(POINTS_PX, rel=0.25)
    assert matched.pose_errors_px == pytest.approx(POSES_PX, rel=0.5)  # six functions of five poses scatter
    again = reprojection_errors(characterised(exact.with_parameters(matched))).px2
    np.testing.assert_allclose(np.sqrt(again), np.sqrt(reprojection_errors(bench).px2), rtol=0.15)


def test_a_twin_that_errs_as_much_already_keeps_its_exact_points() -> None:
    px2 = np.full((2, 2), 1e-4)
    same = SimpleNamespace(px2=px2, sigma_px2=0.1 * px2)
    twin = Twin.of(world(), "board", Blender("bench"))
    at = SimpleNamespace(parameters=twin.parameters, reprojection_errors=lambda: (same, same))
    at.with_parameters = lambda parameters: at
    assert not BoardPointErrors().is_in(BoardPointErrors().propose(cast(Any, at)))
