"""Coordinates beside edges of reflectivity: their bias, the noise elsewhere, and whether σ covers them.

Boards of the virtual bench are judged, and by `python -m benchmarks.reflectivity_edges TARGET SESSION…`
recorded ones. Away from edges a smooth surface is fitted to the coordinates, which follows boards that are
not flat; beside edges across the fringes they are compared with it, towards the brighter side. The baseline
is decoding without the correction, and twice its time.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter

from benchmarks import Result, above, below
from fpplab.core import config
from fpplab.core.conventions import Axis, Floats, Map, Mask
from fpplab.core.robust import robust_spread
from fpplab.devices.rig import Rig
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.phase.limits import EDGES
from fpplab.pipeline.taking import take_poses
from fpplab.sessions.session import Session
from fpplab.targets import Target

RIG, SEEDS, POSES = "rig_demo", (77, 78), 2
"""Judging seeds: others served to develop the correction."""
NEAR_MM, FAR_MM, DEGREE = 0.5, 1.2, 8
WARP_MM = 2.0
"""Extent of what remains of a board's own shape, beyond the surface of that degree."""
BINS = 5
"""Distances at which biases are taken, on either side of an edge."""
TILE_PX = 48
"""Side of tiles whose noise does not depend on that of their neighbours; every other one makes a half."""
COVERED = (0.92, 0.98)
SLOWER, REPEATS = 2.0, 5
"""How many times as long decoding may take with the correction, and how often it is timed."""
WRONG_PX = 4.0
"""Coordinates that are further off have a wrong fringe order; errors at edges are tenths of a pixel."""


def errors_beside_edges(
    recording: Recording, decoded: Decoded, target: Target, axis: Axis
) -> dict[str, Floats]:
    """Find distances from edges in mm, errors towards the brighter side in px, and σ in px, (P,)."""
    image = recording.mean_image()
    detection = target.detect(image)
    assert detection is not None, "the board is not found"
    area = np.zeros(image.shape, np.uint8)
    cv2.fillConvexPoly(area, cv2.convexHull(np.rint(detection.pixels).astype(np.int32)), (1,))
    reach = np.ptp(target.points()[detection.ids, :2], axis=0)
    px_per_mm = float(np.sqrt(area.sum() / reach.prod()))
    level = image.astype(np.float32)
    around = [f(level, np.ones((2 * int(6 * px_per_mm) + 1,) * 2)) for f in (cv2.erode, cv2.dilate)]
    bright = level > 0.5 * (around[0] + around[1])
    distance = np.where(bright, distance_transform_edt(bright), -distance_transform_edt(~bright))
    distance = (distance - 0.5 * np.sign(distance)) / px_per_mm
    coordinate = decoded.coordinate(axis).astype(np.float64)
    used = (area > 0) & np.isfinite(coordinate)
    fitted = _surface(coordinate, used, used & (np.abs(distance) > FAR_MM), decoded.modulation)
    fitted += _warp(coordinate - fitted, used & (np.abs(distance) > FAR_MM), WARP_MM * px_per_mm)
    towards = np.stack(np.gradient(cv2.GaussianBlur(level, (0, 0), 1.5)))
    along = np.stack(np.gradient(fitted))
    cosine = (towards * along).sum(axis=0) / np.maximum(np.hypot(*towards) * np.hypot(*along), 1e-9)
    used &= (np.abs(cosine) > 0.8) | (np.abs(distance) > FAR_MM)
    error = np.sign(cosine) * (coordinate - fitted)
    used &= np.abs(error) < WRONG_PX
    rows, columns = np.indices(image.shape) // TILE_PX
    values = {"distance": distance, "error": error, "sigma": decoded.sigma_total, "noise": decoded.sigma}
    values["half"] = (rows + columns) % 2
    return {name: each[used].astype(np.float64) for name, each in values.items()}


def _surface(coordinate: Floats, used: Mask, far: Mask, modulation: Map) -> Floats:
    """A polynomial through the coordinates far from edges, without outliers; NaN where nothing is used."""
    height, width = coordinate.shape
    rows, columns = np.nonzero(used)
    x, y = 2.0 * columns / width - 1.0, 2.0 * rows / height - 1.0
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    basis = [np.vander(one, DEGREE + 1)[:, ::-1] for one in (x, y)]
    terms = np.stack([basis[0][:, i] * basis[1][:, j] for i, j in powers], axis=1)
    values, kept, weight = coordinate[used], far[used], modulation[used].astype(np.float64)
    for _ in range(3):
        some = np.flatnonzero(kept)[:: max(1, kept.sum() // 60_000)]
        weighted = terms[some] * weight[some, None]
        strengths = np.linalg.lstsq(weighted, values[some] * weight[some], rcond=None)[0]
        rest = (values - terms @ strengths) * weight
        kept &= np.abs(rest) < 5.0 * robust_spread(rest[kept])
    fitted = np.full(coordinate.shape, np.nan)
    fitted[used] = terms @ strengths
    return fitted


def _warp(rest: Floats, far: Mask, extent_px: float) -> Floats:
    """Smooth what a surface leaves far from edges, without outliers."""
    far = far & (np.abs(rest) < 5.0 * robust_spread(rest[far]))
    weight = gaussian_filter(far.astype(np.float64), extent_px)
    return np.asarray(gaussian_filter(np.where(far, rest, 0.0), extent_px) / np.maximum(weight, 1e-9))


def edge_figures(found: dict[str, Floats]) -> tuple[float, float, float]:
    """Bias near edges in px, noise elsewhere in px, and the share of points near edges that σ covers."""
    near, far = np.abs(found["distance"]) < NEAR_MM, np.abs(found["distance"]) > FAR_MM
    bins = np.clip(((found["distance"] / NEAR_MM + 1.0) * BINS).astype(int), 0, 2 * BINS - 1)
    # Noise gives either half of the tiles a mean of its own: their product has the square of the bias alone.
    squares = []
    for k in range(2 * BINS):
        halves = [found["error"][near & (bins == k) & (found["half"] == half)] for half in (0, 1)]
        if min(each.size for each in halves) > 20:
            squares.append(float(halves[0].mean() * halves[1].mean()))
    bias = max(float(np.mean(squares)), 0.0) ** 0.5
    covered = np.abs(found["error"]) < 1.96 * found["sigma"]
    return bias, robust_spread(found["error"][far]), float(covered[near].mean())


def compared(name: str, recording: Recording, target: Target) -> list[Result]:
    """Judge one recording with and without the correction."""
    decoded = decode(recording)
    with patch("fpplab.phase.edges.EDGES", EDGES._replace(significance=np.inf)):
        before = decode(recording)
    seconds = _decoding_seconds(recording)
    with patch("fpplab.phase.decoding.correct_edges", return_value=None):
        results = [below(f"{name}_decoding", seconds, "s", SLOWER * _decoding_seconds(recording))]
    for axis in recording.plan.axes:
        bias, noise, covered = edge_figures(errors_beside_edges(recording, decoded, target, axis))
        was, quiet, _ = edge_figures(errors_beside_edges(recording, before, target, axis))
        results += [below(f"{name}_{axis}_bias", bias, "px", 0.25 * was)]
        results += [below(f"{name}_{axis}_noise_elsewhere", noise, "px", 1.02 * quiet)]
        if axis == recording.plan.axes[0]:
            results += [above(f"{name}_{axis}_covered", covered, "share", COVERED[0])]
            results += [below(f"{name}_{axis}_covered_at_most", covered, "share", COVERED[1])]
    return results


def _decoding_seconds(recording: Recording) -> float:
    """Take the processor's time for decoding, the least of some."""
    seconds = []
    for _ in range(REPEATS):
        begin = time.process_time()
        decode(recording)
        seconds.append(time.process_time() - begin)
    return min(seconds)


def run() -> list[Result]:
    """Judge boards on the virtual bench."""
    results, target = [], config.load_document(config.find_config("target_paper.yaml", "target"), Target)
    for seed in SEEDS:
        with TemporaryDirectory() as folder:
            sessions = twin_sessions(Path(folder), seed)
            for k, session in enumerate(sessions):
                results += compared(f"twin_{seed}_{k}", session.recording(), target)
    return results


def twin_sessions(folder: Path, seed: int) -> list[Session]:
    """Take poses of the board on the virtual bench."""
    world = config.find_config("world_demo.yaml", "world")
    data = config.parse_yaml(world.read_text(), world)
    data |= {"seed": seed, "mounted": "board"}
    data["items"] = {"board": {**data["items"]["board"], "target": str(world.with_name("target_paper.yaml"))}}
    (folder / "world.yaml").write_text(config.to_yaml(data))
    rig = config.parse_yaml(config.find_config(RIG + ".yaml", "rig").read_text(), RIG)
    rig["bench"] |= {"world": "world.yaml", "analytic": True}
    (folder / "rig.yaml").write_text(config.to_yaml(rig))
    with Rig.load(folder / "rig.yaml") as opened:
        return take_poses(opened, Plan.load("plan_board"), "board", POSES, folder / "poses", False)


def main(words: Sequence[str]) -> None:
    """Judge recorded boards."""
    target = config.load_document(config.find_config(words[0], "target"), Target)
    for path in map(Path, words[1:]):
        for result in compared(path.name, Session.open(path).recording(), target):
            print(f"{result.name:34} {result.value:8.4f} {result.baseline:8.4f} {result.unit}")


if __name__ == "__main__":
    main(sys.argv[1:])
