"""Lengths of the demonstration's artefacts: whether their stated uncertainty holds.

The demonstration's poses, parts and rig with other lenses, board and noise in each draw. Observations and
scans are drawn from exact truths: no image is rendered. Lengths of one draw share its calibration.
"""

from collections.abc import Sequence

import numpy as np

from benchmarks import Result, above, below
from benchmarks.guided_characterisation import PROJECTOR_PX, Rigged, demo_world, rigged, unguided
from fpplab import artefacts
from fpplab.artefacts.recognition import recognise
from fpplab.calibration.model import Calibration
from fpplab.characterisation import characterise
from fpplab.characterisation.parameters import DistortionModel
from fpplab.cli import console
from fpplab.clouds import Cloud
from fpplab.comparison import compare
from fpplab.comparison.visibility import RayTracedShape
from fpplab.core.conventions import Floats
from fpplab.phase import Decoded
from fpplab.reconstruction.points import triangulate
from fpplab.reconstruction.triangulation import camera_slopes
from fpplab.targets import Target
from fpplab.workflows.demo import POSES
from sim.items import item_poses

SEEDS = range(9700, 9800)
PIXEL_STEP = 4
"""Every so manieth pixel of the camera sees the part."""
RATIOS, COVERED = (0.9, 1.1), (0.93, 0.97)


def characterised(rig: Rigged, seed: int) -> Calibration:
    """Characterise as the demonstration does."""
    truth, target = rig.truth, Target.load("target_paper")
    sizes = (truth.camera.size, truth.projector.size)
    observations = unguided(rig, seed, POSES)
    fitted = characterise(observations, target, *sizes, truth.projector.lattice, level=DistortionModel.K3)
    return fitted.calibration


def errors_over_stated(rig: Rigged, known: Calibration) -> list[float]:
    """Measure all artefacts, and give the error of each length in standard uncertainties."""
    found = []
    for name in artefacts.NAMES:
        mesh = artefacts.make(name)
        mesh.apply_transform(item_poses(demo_world(0), name)[0].matrix)
        decoded = decoded_scan(rig, RayTracedShape(mesh))
        # Without pixels: these few have no neighbours that would make a surface.
        cloud = Cloud(triangulate(decoded, known, normals=False).points)
        compared = compare(cloud, mesh, known, density=2.0, align=True, artefact=recognise(mesh))
        found += [m.error_um / m.sigma_um for m in compared.lengths if m.error_um is not None and m.sigma_um]
    return found


def decoded_scan(rig: Rigged, shape: RayTracedShape) -> Decoded:
    """See a part along both axes, with noise."""
    camera, projector, pair = rig.truth.camera, rig.truth.projector, rig.truth.T_projector_camera
    width, height = camera.size
    rays = np.stack([*camera_slopes(camera), np.ones((height, width))], axis=-1)
    rows, columns = (grid.ravel() for grid in np.mgrid[0:height:PIXEL_STEP, 0:width:PIXEL_STEP])
    chosen: Floats = rays[rows, columns]
    away = np.linalg.norm(chosen, axis=1)
    depth = shape.depth(np.zeros(3), chosen / away[:, None])
    points = chosen * (depth / away)[:, None]
    hit = np.flatnonzero(np.isfinite(depth))
    hit = hit[projector.sees(points[hit], pair) & shape.unoccluded(rig.truth.projector_centre, points[hit])]
    maps = np.full((2, height, width), np.nan, np.float32)
    seen = projector.project(points[hit], pair) + rig.random.normal(0.0, PROJECTOR_PX, (len(hit), 2))
    maps[:, rows[hit], columns[hit]] = seen.T
    flat, sigma = np.ones((height, width), np.float32), np.full((height, width), PROJECTOR_PX, np.float32)
    return Decoded(maps[0], maps[1], flat, sigma)


def run(seeds: Sequence[int] = SEEDS) -> list[Result]:
    """Characterise, measure, and compare errors with what is stated."""
    found: list[float] = []
    with console.progress("Measuring lengths") as report:
        for k, seed in enumerate(seeds):
            rig = rigged(seed)
            found += errors_over_stated(rig, characterised(rig, seed))
            report((k + 1) / len(seeds))
    rms, covered = float(np.sqrt(np.mean(np.square(found)))), float(np.mean(np.abs(found) < 1.96))
    return [
        above("lengths_error_over_stated", rms, "", RATIOS[0]),
        below("lengths_error_over_stated_at_most", rms, "", RATIOS[1]),
        above("lengths_in_their_intervals", covered, "share", COVERED[0]),
        below("lengths_in_their_intervals_at_most", covered, "share", COVERED[1]),
    ]
