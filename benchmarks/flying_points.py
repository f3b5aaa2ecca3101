"""What the filter's rules remove of points between surfaces, and of good ones, on scenes of known shape.

Spheres and discs in front of a wall are ray-cast with sixteen rays a pixel, a camera's blur, light that goes
round by other surfaces, noise and rounding to 8 bits, under six images as of `plan_slstudio_skull`. A flying
point is more than 1 mm and more than five standard deviations of its noise from the nearest surface.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from benchmarks import Result, above, below
from fpplab.calibration.model import Calibration
from fpplab.cli import console
from fpplab.clouds import Cloud
from fpplab.core.conventions import Floats, Image, axis_length, phase_of_coordinate, phase_steps
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import FilterRules, Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.reconstruction.filtering import apply_filter
from fpplab.reconstruction.points import triangulate

WIDTH, HEIGHT, RAYS = 560, 480, 4
RIG = Calibration(
    Pinhole.from_focal((WIDTH, HEIGHT), (2190.0, 2190.0), ((WIDTH - 1) / 2, (HEIGHT - 1) / 2)),
    Pinhole.from_focal((1824, 1140), (2609.0, 2605.0), (857.0, 1121.0)),
    RigidTransform.from_vectors(np.radians([9.0, 13.1, 7.9]), np.array([-144.6, -37.1, 73.2])),
    {},
)
SEEDS = range(200, 204)
"""Not those by which the rule was chosen."""
RULES = {
    "flying": FilterRules(disagreement_max=0.0, light_min=0.0, patch_min=1),
    "isolated": FilterRules(disagreement_max=0.0, light_min=0.0, flying=False),
    "others": FilterRules(flying=False),
    "all": FilterRules(),
}
NEAREST, FLYING_MM, SIGMAS = 1e-2, 1.0, 5.0

_Numbers = NDArray[np.intp]


class Scene:
    """Spheres and discs in front of a wall, and how they are lit and seen."""

    def __init__(self, seed: int) -> None:
        self._random = random = np.random.default_rng([20261125, seed])
        spheres, discs = random.integers(6, 10), random.integers(3, 7)
        depth = random.uniform(350, 440, spheres + discs)
        across = random.uniform((-0.11, -0.09), (0.11, 0.09), (spheres + discs, 2))
        centres = depth[:, None] * np.column_stack([across, np.ones(len(depth))])
        wall = [0.0, 0.0, random.uniform(430, 520)]
        self._spheres = list(zip(centres[:spheres], random.uniform(5, 22, spheres), strict=True))
        tilts = np.column_stack([random.normal(0, 0.6, (discs, 2)), -np.ones(discs)])
        tilts = np.vstack([tilts, np.append(random.normal(0, 0.2, 2), -1.0)])
        normals = tilts / np.linalg.norm(tilts, axis=1, keepdims=True)
        places = np.vstack([centres[spheres:], wall])
        self._discs = list(zip(places, np.append(random.uniform(4, 18, discs), np.inf), normals, strict=True))
        self._albedo = np.append(random.uniform(0.4, 1.0, spheres + discs), random.choice([0.02, 0.15, 0.7]))
        self._levels, self._round, self._blur_px = random.uniform((60, 0.02, 0.4), (170, 0.15, 0.8))

    def _hit(self, starts: Floats, along: Floats) -> tuple[Floats, _Numbers]:
        """Distances (N,) to the nearest surface along unit vectors (N, 3), and its number, -1 for none."""
        nearest, number = np.full(len(along), np.inf), np.full(len(along), -1)
        found = [_sphere_hit(starts, along, c, r) for c, r in self._spheres]
        found += [_disc_hit(starts, along, *disc) for disc in self._discs]
        for k, distance in enumerate(found):
            closer = (distance > NEAREST) & (distance < nearest)
            nearest[closer], number[closer] = distance[closer], k
        return nearest, number

    def _normals(self, points: Floats, number: _Numbers) -> Floats:
        found = np.zeros_like(points)
        for k, (centre, radius) in enumerate(self._spheres):
            found[number == k] = (points[number == k] - centre) / radius
        for k, (_, _, normal) in enumerate(self._discs, len(self._spheres)):
            found[number == k] = normal
        return found

    def distances(self, points: Floats) -> Floats:
        """Compute the distances of points from the nearest surface."""
        # points (N, 3) mm; returns (N,) mm
        found = [np.abs(np.linalg.norm(points - c, axis=1) - r) for c, r in self._spheres]
        for centre, radius, normal in self._discs:
            height = (points - centre) @ normal
            aside = np.sqrt(np.maximum(np.sum((points - centre) ** 2, axis=1) - height**2, 0.0))
            found.append(np.hypot(height, np.maximum(aside - radius, 0.0)))
        return np.asarray(np.min(found, axis=0))

    def images(self, plan: Plan) -> list[Image]:
        """Render the images of a plan."""
        light, coordinates = self._lit()
        return [
            self._seen(light, coordinates[:, "xy".index(plan.fringes[index].axis)], plan, index, step)
            for index, step, _ in plan.steps()
        ]

    def _lit(self) -> tuple[Floats, Floats]:
        """Light (N,) of a white image by ray, and the projector coordinates (N, 2) that it comes from."""
        ticks = [(np.arange(n * RAYS) + 0.5) / RAYS - 0.5 for n in (WIDTH, HEIGHT)]
        pixels = np.stack(np.meshgrid(*ticks), axis=-1).reshape(-1, 2)
        rays = np.column_stack([RIG.camera.normalise(pixels), np.ones(len(pixels))])
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        distance, number = self._hit(np.zeros(3), rays)
        points = distance[:, None] * rays
        normals = self._normals(points, number)
        normals *= -np.sign(np.sum(normals * rays, axis=1, keepdims=True))
        to_light = RIG.projector_centre - points
        far = np.linalg.norm(to_light, axis=1)
        to_light /= far[:, None]
        inclined = np.maximum(np.sum(normals * to_light, axis=1), 0.0)
        obstacle, _ = self._hit(points + NEAREST * normals, to_light)
        light = self._albedo[number] * np.where(obstacle < far, 0.0, inclined) * (350.0 / far) ** 2
        return light, RIG.projector.project(points, RIG.T_projector_camera)

    def _seen(self, light: Floats, coordinate: Floats, plan: Plan, index: int, step: int) -> Image:
        """One image: blurred, with light that goes round, noise and rounding."""
        fringe = plan.fringes[index]
        assert isinstance(fringe, Sinusoid)
        phase = phase_of_coordinate(coordinate, fringe.stripes, axis_length(RIG.projector.size, fringe.axis))
        wave = 0.52 + 0.48 * np.cos(phase - phase_steps(fringe.steps)[step])
        fine = gaussian_filter((light * wave).reshape(HEIGHT * RAYS, -1), RAYS * self._blur_px)
        direct = fine.reshape(HEIGHT, RAYS, WIDTH, RAYS).mean(axis=(1, 3))
        level = self._levels * (direct + self._round * gaussian_filter(direct, 25.0) + 0.01)
        level += self._random.normal(0.0, 1.0, level.shape) * np.sqrt(0.6**2 + 0.02 * level)
        return np.asarray(np.rint(np.clip(level, 0, 255)), np.uint8)


def _sphere_hit(starts: Floats, along: Floats, centre: Floats, radius: float) -> Floats:
    """Distances (N,) at which rays enter a sphere; NaN where they do not."""
    away = np.broadcast_to(starts - centre, along.shape)
    half = np.sum(away * along, axis=1)
    with np.errstate(invalid="ignore"):
        return np.asarray(-half - np.sqrt(half**2 - np.sum(away**2, axis=1) + radius**2))


def _disc_hit(starts: Floats, along: Floats, centre: Floats, radius: float, normal: Floats) -> Floats:
    """Distances (N,) at which rays meet a disc; NaN where they do not."""
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = ((centre - starts) @ normal) / (along @ normal)
        aside = np.sum((starts + distance[:, None] * along - centre) ** 2, axis=1)
    return np.asarray(np.where(aside < radius**2, distance, np.nan))


def counted(seed: int) -> dict[str, tuple[int, int, int, int]]:
    """Count what each set of rules removes on one scene."""
    scene = Scene(seed)
    plan = Plan.load("plan_slstudio_skull")
    decoded = decode(Recording(scene.images(plan), plan, RIG.projector.size))
    cloud = triangulate(decoded, RIG, normals=False)
    assert cloud.sigma_noise_mm is not None
    off = scene.distances(cloud.points.astype(np.float64))
    flying = (off > FLYING_MM) & (off > SIGMAS * cloud.sigma_noise_mm)
    return {name: _removed(decoded, cloud, plan, rules, flying) for name, rules in RULES.items()}


def _removed(
    decoded: Decoded, cloud: Cloud, plan: Plan, rules: FilterRules, flying: NDArray[np.bool_]
) -> tuple[int, int, int, int]:
    """Flying points removed and all of them, other points removed and all of them."""
    left, _ = apply_filter(decoded, cloud, plan.model_copy(update={"filter": rules}), RIG.projector.size)
    assert left.removed is not None
    assert cloud.pixels is not None
    gone = left.removed[cloud.pixels[:, 1], cloud.pixels[:, 0]] > 0
    return int((gone & flying).sum()), int(flying.sum()), int((gone & ~flying).sum()), int((~flying).sum())


def shares(seeds: Sequence[int]) -> dict[str, tuple[float, float]]:
    """Compute the shares of flying and of other points that each set of rules removes."""
    found = []
    with console.progress("Casting rays") as report:
        for k, seed in enumerate(seeds):
            found.append(counted(seed))
            report((k + 1) / len(seeds))
    totals = {name: np.sum([one[name] for one in found], axis=0) for name in RULES}
    return {name: (float(t[0] / t[1]), float(t[2] / t[3])) for name, t in totals.items()}


def run() -> list[Result]:
    """Measure what the rules remove, the rule of flying points beside the others."""
    found = shares(SEEDS)
    results = []
    for name, (flying, others) in found.items():
        results.append(above(f"flying_removed_{name}", flying, "share", found["isolated"][0]))
        results.append(below(f"others_removed_{name}", others, "share", found["others"][1]))
    return results
