"""Drift: whether it is named rightly, and whether the stated uncertainty contains it.

Poses are drawn from exact truths. The projector's picture walks from pose to pose, and once more until the
scan that the calibration is used for.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks import Result, above, below
from benchmarks.limit_characterisation import PROJECTOR, SIZE, Case, Draw, board, draw, place_errors
from fpplab.characterisation import DistortionModel, characterise
from fpplab.cli import console
from fpplab.core.conventions import Floats
from fpplab.diagnosis.causes.of_characterisation import PROJECTOR_DRIFT
from fpplab.workflows.characterise import findings_of_poses

WALK_PX = 0.3  # of the projector's picture from pose to pose
SEEDS = range(3000, 3020)
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


def run() -> list[Result]:
    """Characterise with a projector that walks and with one at rest."""
    results = []
    with console.progress("Drift") as report:
        for k, (name, walk_px, right) in enumerate(
            (("walking", WALK_PX, [PROJECTOR_DRIFT.key]), ("at_rest", 0.0, []))
        ):
            sessions = [place_of_session(walk_px, seed) for seed in SEEDS]
            actual, stated = np.sqrt(np.mean(np.square([one[:2] for one in sessions]), axis=0))
            named = float(np.mean([one[2] == right for one in sessions]))
            results += [
                above(f"{name}_named_rightly", named, "share", MIN_NAMED),
                above(f"{name}_stated_over_actual", stated / actual, "ratio", RATIOS[0]),
                below(f"{name}_stated_over_actual_at_most", stated / actual, "ratio", RATIOS[1]),
                below(f"{name}_actual", float(actual), "um", float(stated)),
            ]
            report((k + 1) / 2)
    return results
