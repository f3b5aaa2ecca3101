"""Guided characterisation with at most 12 poses beside 20 poses as `take_poses` draws them.

The rig is that of the demonstration with other lenses in each draw; observations are drawn from exact truths:
no image is rendered. A person holds the board where the guide wants it only to several mm and degrees.
True errors of form and place are those of points triangulated from exact pixels of the working volume, but
for the scale of the board, which no pose tells. Board, poses, noise and hands are fresh in each draw.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks import Result, above, below
from fpplab.calibration.model import Calibration
from fpplab.characterisation import Observation, characterise
from fpplab.characterisation.candidate_poses import candidate_poses
from fpplab.characterisation.estimate import first_estimate
from fpplab.characterisation.guide import Guide
from fpplab.characterisation.next_pose import Design, best_pose
from fpplab.characterisation.parameters import DistortionModel, Solution, vectors_of
from fpplab.characterisation.pose_effects import smooth_functions
from fpplab.characterisation.working_volume import WorkingVolume, moved_points, without_motion
from fpplab.cli import console
from fpplab.core.conventions import Floats
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.targets import Target
from sim.items import board_poses
from sim.world import PoseRules, World

DEPTH_MM = (425.0, 475.0)
"""Working depths: the range in which `take_poses` has the boards of the demonstration."""
GUIDED, UNGUIDED = 12, 20
HAND_MM, HAND_DEG = 4.0, 4.0
"""Standard deviation of each coordinate, and about each axis, of where a person holds the board."""
CAMERA_PX, PROJECTOR_PX, SHARED_PX = 0.03, 0.03, 0.01
"""Noise of points in both devices, and each of the smooth errors that the points of one pose share."""
DOTS_MM, SCALE = 0.005, 2e-4
"""Board's points from where they are drawn, and its relative scale."""
SEEDS = range(7000, 7020)
COVERED = (0.75, 1.25)
"""Root mean square of true errors over stated ones: within that of 20 draws of few independent components."""


@dataclass(frozen=True, eq=False)
class Rigged:
    """A true rig with a board."""

    truth: Calibration  # both devices
    board: Floats  # (P, 3) true points of the board in mm
    scale: float  # relative error of the board's scale
    random: np.random.Generator  # of poses, hands and noise

    def observed(self, name: str, pose: RigidTransform) -> Observation:
        """Observe the board."""
        places, pair = pose.apply(self.board), self.truth.T_projector_camera
        seen = self.truth.camera.sees(places) & self.truth.projector.sees(places, pair)
        ids = np.flatnonzero(seen)
        functions = smooth_functions(self.board[ids, :2])
        pixels = []
        for device, at, noise in (
            (self.truth.camera, None, CAMERA_PX),
            (self.truth.projector, pair, PROJECTOR_PX),
        ):
            shared = functions @ self.random.normal(0, SHARED_PX, (functions.shape[1], 2))
            own = self.random.normal(0, noise, (len(ids), 2))
            pixels.append(device.project(places[ids], at) + shared + own)
        return Observation(name, ids, pixels[0], pixels[1])

    def held(self, wanted: RigidTransform) -> RigidTransform:
        """Hold the board as a person does who is asked for a pose."""
        turn = RigidTransform.from_vectors(np.radians(self.random.normal(0, HAND_DEG, 3)), np.zeros(3))
        shift = wanted.translation + self.random.normal(0, HAND_MM, 3)
        return RigidTransform(wanted.rotation @ turn.rotation, shift)


def demo_world(seed: int) -> World:
    """Load the world of the demonstration with other random poses."""
    return World.load("world_demo.yaml").model_copy(update={"seed": seed})


def rigged(seed: int) -> Rigged:
    """Draw lenses and a board."""
    random, world = np.random.default_rng([38, seed]), demo_world(seed)

    def other(lens: Pinhole) -> Pinhole:
        distortion = lens.distortion * random.uniform(0.3, 1.7, len(lens.distortion))
        return Pinhole(lens.size, lens.matrix, distortion, lens.lattice)

    truth = Calibration(
        other(world.camera_model()), other(world.projector_model()), world.T_projector_camera(), {}
    )
    scale, drawn = SCALE * random.standard_normal(), Target.load("target_paper").points()
    board = (1.0 + scale) * (drawn + random.normal(0, DOTS_MM, drawn.shape))
    return Rigged(truth, board, scale, random)


def unguided(rig: Rigged, seed: int, count: int) -> list[Observation]:
    """Observe poses as `take_poses` has them on the demonstration's rig."""
    rules = PoseRules(count=count, tilt_deg=30, distance_mm=450, range_mm=25)
    poses = board_poses(demo_world(seed), "board", Target.load("target_paper").size_mm, rules)
    return [rig.observed(f"pose_{k:02d}", pose) for k, pose in enumerate(poses)]


def guided(rig: Rigged, count: int, stop: Callable[[Guide], bool] = lambda guide: False) -> Guide:
    """Guide a person."""
    camera, projector = rig.truth.camera, rig.truth.projector
    guide = Guide(Target.load("target_paper"), (camera.size, projector.size), projector.lattice, DEPTH_MM)
    while len(guide.observations) < count and not stop(guide):
        wanted = guide.next_pose().T_camera_target or RigidTransform(np.eye(3), np.array([0.0, 0.0, 450.0]))
        guide.add(rig.observed(f"pose_{len(guide.observations):02d}", rig.held(wanted)))
    return guide


@dataclass(frozen=True)
class Errors3D:
    """Errors of one characterisation in µm, root mean square over the working volume, without the scale."""

    form: float  # true errors
    place: float  # true errors
    stated_form: float  # by the covariance
    stated_place: float  # by the covariance
    poses: int  # how many there were


def errors_of(rig: Rigged, observations: Sequence[Observation]) -> Errors3D:
    """Characterise, and compare with the truth."""
    truth, target, level = rig.truth, Target.load("target_paper"), DistortionModel.K3
    sizes = (truth.camera.size, truth.projector.size)
    found = characterise(observations, target, *sizes, truth.projector.lattice, level=level)
    assert found.solution is not None
    assert found.calibration.uncertainty is not None
    points = WorkingVolume.of(truth, DEPTH_MM).points
    exact = _devices(truth)
    pair = exact.T_projector_camera
    slopes = moved_points(exact, level, points)
    error = _parameters(found.solution, level) - _parameters(exact, level)
    longer = np.append(np.zeros(len(error) - 3), pair[3:])
    # The estimate believes the board as drawn; with the true scale all its lengths are longer.
    error[-3:] += rig.scale * found.solution.T_projector_camera[3:]
    covariance = found.calibration.uncertainty.covariance - np.outer(longer, longer) * SCALE**2
    figures = []
    for moved in (without_motion(slopes, points), slopes):
        stated = float(np.einsum("mi,ij,mj->", moved, covariance, moved))
        figures += [1e3 * np.sqrt(np.array([np.sum((moved @ error) ** 2), stated]) / len(points))]
    (form, stated_form), (place, stated_place) = figures
    return Errors3D(form, place, stated_form, stated_place, len(found.observations))


def _devices(truth: Calibration) -> Solution:
    lenses = [
        np.concatenate([d.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], d.distortion])
        for d in (truth.camera, truth.projector)
    ]
    pair = vectors_of(truth.T_projector_camera)
    return Solution(lenses[0], lenses[1], pair, np.zeros((0, 6)), np.zeros((0, 3)))


def _parameters(solution: Solution, level: DistortionModel) -> Floats:
    free = len(level.terms)
    return np.concatenate([solution.camera[:free], solution.projector[:free], solution.T_projector_camera])


def both_ways(seeds: Sequence[int]) -> dict[str, list[Errors3D]]:
    """Characterise each rig in both ways."""
    found: dict[str, list[Errors3D]] = {"guided": [], "unguided": []}
    with console.progress("Characterising") as report:
        for k, seed in enumerate(seeds):
            rig = rigged(seed)
            found["guided"].append(errors_of(rig, guided(rig, GUIDED).observations))
            found["unguided"].append(errors_of(rig, unguided(rig, seed, UNGUIDED)))
            report((k + 1) / len(seeds))
    return found


def run() -> list[Result]:
    """Compare guided with unguided poses, and true with stated errors."""
    found = both_ways(SEEDS)

    def rms(way: str, what: str) -> float:
        return float(np.sqrt(np.mean([getattr(one, what) ** 2 for one in found[way]])))

    results = [
        below(f"{what}_{GUIDED}_guided", rms("guided", what), "um", rms("unguided", what))
        for what in ("form", "place")
    ]
    for what in ("form", "place"):
        ratio = rms("guided", what) / rms("guided", f"stated_{what}")
        results += [
            above(f"{what}_over_stated", ratio, "", COVERED[0]),
            below(f"{what}_over_stated_at_most", ratio, "", COVERED[1]),
        ]
    return [*results, time_of_choice()]


def time_of_choice() -> Result:
    """Time the choice among all candidate poses beside the characterisation that it is made from."""
    rig, target = rigged(SEEDS[0]), Target.load("target_paper")
    truth = rig.truth
    observations = guided(rig, 5).observations
    seconds = []
    for _ in range(3):
        begin = time.process_time()
        estimate, _ = first_estimate(
            observations, target, (truth.camera.size, truth.projector.size), truth.projector.lattice
        )
        adjusted = time.process_time()
        candidates = candidate_poses(estimate.calibration, target.size_mm, DEPTH_MM)
        best_pose(Design.of(estimate, WorkingVolume.of(estimate.calibration, DEPTH_MM)), candidates)
        seconds.append((time.process_time() - adjusted, adjusted - begin))
    choice, characterisation = np.median(seconds, axis=0)
    return below("choice_of_next_pose", float(choice), "s", float(characterisation))
