"""What is left between a matched twin and its bench, for the intervals of predictions.

Noise is compared in some poses of the board whose images the light was not fitted to, where there are such,
and in scans; distance and completeness in scans. Bench and twin are measured the same way. The contrast of
fine fringes in scans is fitted, their noise and distance are not.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from fpplab.core.conventions import Floats, Image
from fpplab.core.errors import DataError
from fpplab.patterns.fringe_sets import FringeSet
from fpplab.phase import decode
from sim.matching.fluctuation.scan_motion import motion_of_scan
from sim.matching.judging.measured import expected_figures, measured_figures
from sim.matching.light.contrast import ContrastSample, board_contrasts, sample_contrasts
from sim.matching.loss import board_mask, subsample_pixels
from sim.matching.reference import Reference
from sim.matching.samples import TILES, tile_numbers
from sim.matching.scene.artefacts import BenchScan, placed_part, scan_by_twin
from sim.matching.steps import SAMPLED_POSES
from sim.prediction import Discrepancy, MeasuredFigures, median_figures
from sim.prediction.discrepancy import (
    ContrastDeviation,
    Deviation,
    LevelDifferences,
    ScanEffects,
    named_effects,
)
from sim.twin import Twin


def discrepancy_of(reference: Reference, twin: Twin, scans: Sequence[BenchScan]) -> Discrepancy:
    fitted = set(reference.spread_poses(SAMPLED_POSES))
    others = [pose for pose in range(len(reference.sessions)) if pose not in fitted]
    judged = others[:: -(-len(others) // SAMPLED_POSES)] if others else sorted(fitted)
    noise = [_noise_difference(reference, twin, pose) for pose in judged]
    pairs = [scan_figures(reference, twin, scan) for scan in scans]
    levels = level_differences(reference, twin)
    part_noise = [float(np.log(a.noise_um / b.noise_um)) for a, b in pairs]
    contrasts = sample_contrasts(twin, scans, reference.plan)
    contrast_differences = {sample.number: sample.relative_residual(reference, twin) for sample in contrasts}
    discrepancy = Discrepancy(
        noise=Deviation.of_kinds([noise, part_noise], fitted=not others),
        distance=_deviation([float(np.log(a.distance_um / b.distance_um)) for a, b in pairs]),
        completeness=_deviation([a.completeness - b.completeness for a, b in pairs]),
        contrast=_finest_contrast_deviation(reference, twin, contrasts, contrast_differences, judged),
        parts=tuple(scan.item for scan in scans),
        levels=levels.model_copy(update={"left_out": tuple(_name(reference, pose) for pose in others)}),
    )
    effects = [
        _effects_of_scan(twin, scan, contrast_differences.get(number)) for number, scan in enumerate(scans)
    ]
    looks_like, not_for = named_effects(discrepancy, noise, part_noise, effects)
    return discrepancy.model_copy(update={"looks_like": looks_like, "not_for": not_for})


def level_differences(reference: Reference, twin: Twin) -> LevelDifferences:
    """Compare the levels of bench and twin by pose, pattern and place on the board."""
    images = reference.one_of_each_set
    squares = [_relative_squares(reference, twin, pose, images) for pose in range(len(reference.sessions))]
    by_image, tiles, pixels = zip(*squares, strict=True)
    count = np.sum(pixels, axis=0)
    places = [
        float(np.sqrt(total / n)) if n else None
        for total, n in zip(np.sum(tiles, axis=0).tolist(), count.tolist(), strict=True)
    ]
    return LevelDifferences(
        by_pose={
            _name(reference, pose): float(np.sqrt(values.mean())) for pose, values in enumerate(by_image)
        },
        by_pattern={
            reference.patterns[index].id: float(np.sqrt(values))
            for index, values in zip(images, np.mean(by_image, axis=0), strict=True)
        },
        by_place=tuple(tuple(places[row : row + TILES]) for row in range(0, TILES**2, TILES)),
    )


def _relative_squares(
    reference: Reference, twin: Twin, pose: int, images: Sequence[int]
) -> tuple[Floats, Floats, Floats]:
    """Mean square over the board of every image (n,), and sum and number of pixels of the tiles (TILES²,)."""
    now = twin.parameters
    pixels = subsample_pixels(board_mask(now.calibration.camera, now.poses[pose], reference.target), 5_000)
    recorded = reference.frames(pose, images)[:, *pixels].astype(np.float64)
    expected = twin.expected_at(pose, reference.shown(images), reference.settings, pixels)
    square = ((recorded - expected) / recorded.mean()) ** 2
    tiles, every = tile_numbers(pixels), square.mean(axis=0)
    sums, counts = (
        np.asarray(np.bincount(tiles, weights, TILES**2), np.float64)
        for weights in (every, np.ones_like(every))
    )
    return square.mean(axis=1), sums, counts


def _noise_difference(reference: Reference, twin: Twin, pose: int) -> float:
    """Logarithm of the bench's noise of the coordinate over the twin's, on the board."""
    own = twin.frames(pose, reference.patterns, reference.settings)
    now = twin.parameters
    board = board_mask(now.calibration.camera, now.poses[pose], reference.target)

    def noise(frames: Sequence[Image]) -> float:
        sigma = decode(reference.recording(pose, frames)).sigma[board]
        if not np.isfinite(sigma).any():
            raise DataError(f"{_name(reference, pose)}: no pixel of the board was decoded")
        return float(np.nanmedian(sigma))

    return float(np.log(noise(reference.recorded(pose)) / noise(own)))


def _effects_of_scan(twin: Twin, scan: BenchScan, contrast_differences: Floats | None) -> ScanEffects:
    """What a scan shows by itself; its contrast less the twin's, relative to the bench's, by tiles."""
    difference = 0.0 if contrast_differences is None else float(np.median(contrast_differences))
    contrast = 1.0 / (1.0 - difference) - 1.0  # relative to the twin's
    motion = motion_of_scan(twin, scan)
    moved = motion.um_per_frame if motion and motion.is_significant else None
    return ScanEffects(scan.item, contrast, moved)


def _finest_contrast_deviation(
    reference: Reference,
    twin: Twin,
    finer_than_board: Sequence[ContrastSample],
    differences_by_sample: Mapping[int, Floats],
    poses: Sequence[int],
) -> ContrastDeviation | None:
    """Compare contrasts of the finest fringes: on parts if they are finer there than on the board."""
    # None where neither has fringes.
    if finer_than_board:
        stripes = max(fringe.stripes for sample in finer_than_board for fringe in sample.sets)
        differences = np.concatenate([differences_by_sample[sample.number] for sample in finer_than_board])
    else:
        finest = reference.plan.sets[reference.finest_sets[0]]
        if not isinstance(finest, FringeSet):
            return None
        stripes = finest.stripes
        differences = board_contrasts(reference, twin, poses)
    return ContrastDeviation(stripes=stripes, relative=float(np.sqrt(np.mean(differences**2))))


def scan_figures(
    reference: Reference, twin: Twin, scan: BenchScan
) -> tuple[MeasuredFigures, MeasuredFigures]:
    placed = placed_part(twin, scan)
    real = measured_figures(scan.session, reference.characterisation.calibration, placed)
    session, calibration, own = scan.session, twin.parameters.calibration, []
    # Flicker and vibration differ from one scan to the next, of which the twin may have any number.
    for _ in range(5):
        own.append(expected_figures(scan_by_twin(twin, scan), calibration, placed, session.depth))
    return real, median_figures(own)


def _deviation(differences: Sequence[float]) -> Deviation | None:
    return Deviation.of(differences, fitted=False) if differences else None


def _name(reference: Reference, pose: int) -> str:
    return reference.sessions[pose].path.name
