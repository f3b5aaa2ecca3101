"""Calibrations corrected by one to three poses of the board, after a change of the rig.

The rigs are those of `guided_characterisation`, each characterised anew, the changes those of `stale`. A
correction keeps the errors of its calibration but for what has changed, so that many rigs count, not changes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks import Result, above, below
from benchmarks.guided_characterisation import DEPTH_MM, rigged, unguided
from benchmarks.lengths import characterised
from benchmarks.limit_characterisation import is_displacement_covered
from benchmarks.stale import COVERAGE, KINDS
from fpplab.calibration.changes import parameter_vector
from fpplab.calibration.displacements import calibration_jacobian
from fpplab.calibration.model import PARAMETERS, Calibration
from fpplab.characterisation import Observation, judge
from fpplab.characterisation.correction import correct
from fpplab.characterisation.working_volume import WorkingVolume, without_motion
from fpplab.cli import console
from fpplab.core.errors import CalibrationError

SEEDS, CHANGES = range(9700, 9760), 5
SIZES = (0.3, 5.0)
"""Range of the sizes of changes, in units of what happens unnoticed."""
FRESH = 8
"""Poses by which corrected calibrations and new ones are judged."""
ALLOWED = {1: 1.5, 2: 1.3, 3: 1.2}
"""Errors in fresh poses, over those of a new characterisation, by poses of the correction."""
COVERED, MOST_REFUSED = (0.93, 0.97), 0.02
QUANTITIES = ("camera.fx", "camera.fy", "projector.fx", "projector.fy")


@dataclass(frozen=True)
class JudgedCorrection:
    """One correction."""

    poses: int
    inside: tuple[bool, ...]  # which intervals of 95 % contain the truth; none of one that was refused
    error_px: float  # in fresh poses; NaN where these were not taken
    anew_px: float  # the same of a new characterisation


def covered_quantities(calibration: Calibration, truth: Calibration) -> tuple[bool, ...]:
    """Tell which 95 % intervals contain the truth: of focal lengths, baseline, place and form."""
    known, pair = calibration.uncertainty, truth.T_projector_camera.translation
    assert known is not None
    rows = [PARAMETERS.index(name) for name in known.names]
    error = (parameter_vector(calibration) - parameter_vector(truth))[rows]
    along = np.append(np.zeros(len(rows) - 3), pair / np.linalg.norm(pair))
    lines = [*np.eye(len(rows))[[known.names.index(name) for name in QUANTITIES]], along]
    points = WorkingVolume.of(truth, DEPTH_MM).points
    slopes = calibration_jacobian(points, truth, (1.0, 1.0)).reshape(-1, len(PARAMETERS))[:, rows]
    return (
        *(bool(abs(a @ error) < COVERAGE * np.sqrt(a @ known.covariance @ a)) for a in lines),
        *(
            is_displacement_covered(m, known.covariance, error)
            for m in (slopes, without_motion(slopes, points))
        ),
    )


def judged_corrections(seed: int) -> Iterator[JudgedCorrection]:
    """Characterise a rig, and correct it after changes; the first is also characterised anew."""
    rig, random = rigged(seed), np.random.default_rng([seed, 77])
    calibration = characterised(rig, seed)
    for change in range(CHANGES):
        kind = list(KINDS)[random.integers(len(KINDS))]
        size = float(np.exp(random.uniform(*np.log(SIZES))) * random.choice([-1, 1]))
        now = replace(rig, truth=KINDS[kind](rig.truth, size))
        fresh, anew_px = list[Observation](), np.nan
        if change == 0:
            fresh = unguided(now, 1000 * seed, FRESH)
            anew_px = left_out_px(characterised(now, 100 * seed), fresh)
        for poses in ALLOWED:
            taken = unguided(now, 1000 * seed + 10 * change + poses, poses)
            try:
                corrected = correct(calibration, taken).calibration
            except CalibrationError as error:
                # What poses contradict is no correction: who asked is told to characterise again.
                console.log_status(f"{seed}: {kind} by {size:+.1f}, {poses} poses: refused: {error}")
                yield JudgedCorrection(poses, (), np.nan, np.nan)
                continue
            error_px = left_out_px(corrected, fresh) if fresh else np.nan
            yield JudgedCorrection(poses, covered_quantities(corrected, now.truth), error_px, anew_px)


def left_out_px(calibration: Calibration, fresh: Sequence[Observation]) -> float:
    """Compute the RMS error in both devices in poses that nothing was fitted to but the board's place."""
    judged = judge(calibration, fresh)
    return float(np.hypot(judged.camera.rms_px, judged.projector.rms_px))


def run() -> list[Result]:
    """Judge corrections of all rigs."""
    judged: list[JudgedCorrection] = []
    with console.progress("Correcting") as report:
        for k, seed in enumerate(SEEDS):
            judged += judged_corrections(seed)
            report((k + 1) / len(SEEDS))
    return [result for poses in ALLOWED for result in figures_of_corrections(judged, poses)]


def figures_of_corrections(judged: Sequence[JudgedCorrection], poses: int) -> list[Result]:
    """Count intervals, and compare errors with those of a new characterisation."""
    every = [one for one in judged if one.poses == poses]
    some = [one for one in every if one.inside]
    covered = float(np.mean([one.inside for one in some]))
    ratios = [one.error_px / one.anew_px for one in some if np.isfinite(one.anew_px)]
    return [
        below(f"left_out_{poses}_over_anew", float(np.sqrt(np.mean(np.square(ratios)))), "", ALLOWED[poses]),
        above(f"covered_{poses}", covered, "share", COVERED[0]),
        below(f"covered_{poses}_at_most", covered, "share", COVERED[1]),
        below(f"refused_{poses}", 1.0 - len(some) / len(every), "share", MOST_REFUSED),
    ]
