"""Drift: whether it is named rightly, and whether the stated uncertainty contains it.

Poses are drawn from exact truths. The projector's picture walks from pose to pose, and once more until the
scan that the calibration is used for. Scans are drawn by formulas with a calibration that is as uncertain
as it says, and that holds when the first frame is taken.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks import Result, above, below
from benchmarks.limit_characterisation import PROJECTOR, SIZE, Case, Draw, board, draw, place_errors
from fpplab.calibration.model import Uncertainty
from fpplab.characterisation import DistortionModel, characterise
from fpplab.characterisation.parameters import parameter_names
from fpplab.cli import console
from fpplab.core.conventions import Floats
from fpplab.diagnosis.causes.projector_drift import PROJECTOR_DRIFT
from fpplab.diagnosis.verdict import diagnose_scan
from fpplab.patterns.plan import Plan
from fpplab.phase import decode
from fpplab.pipeline.measuring import widened_by_drift
from fpplab.reconstruction.points import points_of
from fpplab.reconstruction.triangulation import coordinate_noise
from fpplab.reconstruction.uncertainty import with_uncertainty
from fpplab.workflows.characterise import findings_of_poses
from tests.diagnosis.scenes import Bench

PLAN = Plan.load("plan_scan")

WALK_PX = 0.3  # of the projector's picture from pose to pose
SCAN_PX, SCAN_LIGHT = 0.5, 0.05  # by which picture and light change over a scan, in either direction
CENTRE_PX = 0.1  # uncertainty of the projector's principal point in scans
SEEDS = range(3100, 3120)
MIN_NAMED, RATIOS = 0.95, (0.8, 1.25)


def walked(seen: Draw, walk_px: float, seed: int) -> tuple[Draw, Floats]:
    """Let the projector's picture walk from pose to pose, and to what follows them."""
    # returns the poses, and where the picture then lies (2,) px
    random = np.random.default_rng([20261129, seed])
    at = np.cumsum(random.normal(0.0, walk_px, (len(seen.observations) + 1, 2)), axis=0)
    shifted = [
        replace(o, projector_px=o.projector_px + by) for o, by in zip(seen.observations, at[:-1], strict=True)
    ]
    return replace(seen, observations=shifted), at[-1]


def place_of_session(walk_px: float, seed: int) -> tuple[float, float, list[str]]:
    """Compute how far the next scan is off in µm and how far that is stated; name what is found."""
    seen, later_px = walked(draw(Case(), seed), walk_px, seed)
    found = characterise(seen.observations, board(), SIZE, PROJECTOR, level=DistortionModel.K3)
    truth = replace(seen.truth, projector=seen.truth.projector + np.pad(later_px, (2, 8)))
    actual, stated = place_errors(found, replace(seen, truth=truth))
    return actual, stated, [finding.cause.key for finding in findings_of_poses(found)]


def place_of_scan(changes: bool, seed: int) -> tuple[float, float, list[str]]:
    """Compute how far a scan is off in µm and how far that is stated, as medians; name what is found."""
    random = np.random.default_rng([20261129, 1, seed])
    signs, centre_px = changes * random.choice([-1.0, 1.0], 2), random.normal(0.0, CENTRE_PX)
    bench = Bench(PLAN, seed=seed, drift_px=SCAN_PX * signs[0], warms=SCAN_LIGHT * signs[1])
    true, recording = bench.rig(), bench.recording()
    matrix = true.projector.matrix.copy()
    matrix[0, 2] += centre_px
    names = parameter_names(DistortionModel.K3)
    sigmas = np.array([CENTRE_PX if name == "projector.cx" else 1e-9 for name in names])
    projector = replace(true.projector, matrix=matrix)
    calibration = replace(true, projector=projector, uncertainty=Uncertainty(names, np.diag(sigmas**2)))
    decoded, cloud = points_of(decode(recording), calibration, PLAN)
    widened = widened_by_drift(calibration, decoded.drifts)
    cloud = with_uncertainty(cloud, widened, coordinate_noise(decoded))
    found = diagnose_scan(recording, decoded, cloud, calibration).findings
    assert cloud.pixels is not None
    assert cloud.sigma_mm is not None
    u, v = cloud.pixels.astype(int).T
    off = np.linalg.norm(cloud.points - bench.truth()[v, u], axis=1)
    return (
        1e3 * float(np.median(off)),
        1e3 * float(np.median(cloud.sigma_mm)),
        [f.cause.key for f in found[:1]],
    )


def run() -> list[Result]:
    """Characterise and scan with a projector that walks and with one at rest."""
    cases: tuple[tuple[str, Callable[[int], tuple[float, float, list[str]]], bool], ...] = (
        ("walking_poses", partial(place_of_session, WALK_PX), True),
        ("poses_at_rest", partial(place_of_session, 0.0), False),
        ("walking_scan", partial(place_of_scan, True), True),
        ("scan_at_rest", partial(place_of_scan, False), False),
    )
    results = []
    with console.progress("Drift") as report:
        for k, (name, measure, drifts) in enumerate(cases):
            found = [measure(seed) for seed in SEEDS]
            actual, stated = np.sqrt(np.mean(np.square([one[:2] for one in found]), axis=0))
            named = float(np.mean([one[2] == [PROJECTOR_DRIFT.key] * drifts for one in found]))
            results += [
                above(f"{name}_named_rightly", named, "share", MIN_NAMED),
                above(f"{name}_stated_over_actual", stated / actual, "ratio", RATIOS[0]),
                below(f"{name}_stated_over_actual_at_most", stated / actual, "ratio", RATIOS[1]),
                below(f"{name}_actual", float(actual), "um", float(stated)),
            ]
            report((k + 1) / len(cases))
    return results
