"""From the last frame to the cloud on disk, beside a straightforward pipeline of NumPy and OpenCV.

A session of 36 frames lies complete on disk, in the page cache. The product reads and checks it, decodes,
masks, triangulates, filters, gives every point its uncertainty, and writes decoded maps, cloud and
calibration, as `fpplab scan` does after its last frame. The baseline reads the same files, decodes them as
one writes it down, triangulates by OpenCV's linear method, and writes points alone: without normals,
filter, uncertainty or maps.
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import cv2
import numpy as np

from benchmarks import Result, below
from benchmarks.decode import FrameStack, plain_numpy
from fpplab.calibration.model import PARAMETERS, Calibration, Uncertainty
from fpplab.core.conventions import TWO_PI, Floats
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.core.session_names import CALIBRATION, CLOUD, DECODED
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.plan import Plan
from fpplab.pipeline.measuring import finish_scan
from fpplab.reconstruction.triangulation import camera_slopes
from fpplab.sessions.session import Session

SIZES = {"1.2mp": (1280, 960), "5mp": (2736, 1824), "20mp": (5472, 3648)}
MOST_S = {"5mp": 1.0, "20mp": 3.0}
ROUNDS = 3
PLAN = Plan.load("plan_paper")


def run() -> list[Result]:
    """Measure all sizes; five minutes on two cores."""
    return [result for name in SIZES for result in cloud_figures(name)]


def cloud_figures(name: str) -> list[Result]:
    """Measure one size, product and baseline in turn."""
    calibration = rig_of(SIZES[name])
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        session = recorded(Path(folder) / "session", calibration)
        finish_scan(session, calibration)  # compiles, and fills the page cache
        product, baseline = [], []
        for _ in range(ROUNDS):
            for result in (DECODED, CLOUD, CALIBRATION):  # after the last frame there are none
                (session.path / result).unlink()
            product.append(_seconds(lambda: finish_scan(session, calibration)))
            baseline.append(_seconds(lambda: straightforward(session, calibration)))
    ours, theirs = median(product), median(baseline)
    beside = Result(f"last_frame_to_cloud_{name}", ours, "s", theirs, theirs / ours)
    return [beside, *(below(f"{beside.name}_most", ours, "s", MOST_S[n]) for n in MOST_S if n == name)]


def _seconds(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def rig_of(size: tuple[int, int]) -> Calibration:
    """Make a calibration with its covariance."""
    # size (width, height) px
    focal = size[0] / 169.0 * 450.0
    camera = Pinhole.from_focal(size, (focal, focal), (size[0] / 2, size[1] / 2), (-0.12, 0.08, 0.001, 0, 0))
    projector = Pinhole.from_focal((912, 1140), (1700.0, 1700.0), (450.0, 600.0), (-0.08, 0.05, 0, 0.001, 0))
    turn = RigidTransform.from_vectors(np.array([0.01, -np.arctan2(150.0, 450.0), 0.005]), np.zeros(3))
    place = np.array([-150.0, 4.0, 6.0])
    spread = [_spread_of(name) for name in PARAMETERS]
    known = Uncertainty(tuple(PARAMETERS), np.diag(np.square(spread)))
    pose = RigidTransform(turn.rotation, -turn.rotation @ place)
    return Calibration(camera, projector, pose, {}, uncertainty=known)


def _spread_of(name: str) -> float:
    """Standard uncertainty of a parameter, as a good characterisation states it."""
    kind = name.split("_")[-1]
    return {"fx": 0.5, "fy": 0.5, "cx": 0.4, "cy": 0.4}.get(kind, 0.03 if kind[0] == "t" else 1e-4)


def recorded(path: Path, calibration: Calibration, plan: Plan = PLAN) -> Session:
    """Record what the camera sees of a waved surface, with noise of about one grey level."""
    across, down = camera_slopes(calibration.camera)
    depth = 450.0 + 15.0 * np.sin(40.0 * across) * np.cos(30.0 * down) + 40.0 * across
    points = np.stack([across * depth, down * depth, depth], axis=-1)
    u = calibration.projector.project(points, calibration.T_projector_camera)[..., 0]
    position = ((u + 0.5) / calibration.projector.size[0]).astype(np.float32)
    random, session = np.random.default_rng(1), Session.create(path, plan, rig_record(calibration))
    noise = random.normal(0.0, 1.0, (position.shape[0], 2 * position.shape[1])).astype(np.float32)
    for index, (k, step, name) in enumerate(plan.steps()):
        fringe = plan.fringes[k]
        wave = np.cos(np.float32(TWO_PI) * (np.float32(fringe.stripes) * position - step / fringe.images))
        start = random.integers(position.shape[1])
        image = np.rint(120.0 + 90.0 * wave + noise[:, start : start + position.shape[1]]).astype(np.uint8)
        session.write(
            Frame(image, index, CameraSettings(plan.exposure_s, 0.0, 8), time.time(), pattern_id=name)
        )
    return session


def straightforward(session: Session, calibration: Calibration) -> None:
    """Read, decode, triangulate and write as one writes it down: the baseline."""
    files = [session.path / session.record(i).file for i in range(PLAN.images)]
    frames: FrameStack = [cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in files]  # type: ignore[misc]
    coordinate, _, valid = plain_numpy(frames)
    v, u = np.nonzero(valid)
    pixels = np.stack([u, v], axis=1).astype(np.float64)
    points = _points(calibration, pixels, coordinate[valid].astype(np.float64))
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    with (session.path / "baseline.ply").open("wb") as file:
        file.write(head.encode())
        points.astype("<f4").tofile(file)


def _points(calibration: Calibration, pixels: Floats, columns: Floats) -> Floats:
    """Cut each pixel's ray with the plane of light of its column."""
    camera, projector = calibration.camera, calibration.projector
    rays = np.concatenate(
        [
            cv2.undistortPoints(pixels[:, None], camera.matrix, camera.distortion)[:, 0],
            np.ones((len(pixels), 1)),
        ],
        axis=1,
    )
    rows = np.full_like(columns, projector.size[1] / 2)
    seen = np.stack([columns, rows], axis=1)[:, None]
    slope = cv2.undistortPoints(seen, projector.matrix, projector.distortion)[:, 0, 0]
    pose = calibration.T_projector_camera
    normal = pose.rotation[0] - slope[:, None] * pose.rotation[2]
    depth = (slope * pose.translation[2] - pose.translation[0]) / np.sum(normal * rays, axis=1)
    return np.asarray(rays * depth[:, None])


def rig_record(calibration: Calibration) -> dict[str, object]:
    """Describe a rig as a session records it."""
    projector = calibration.projector
    resolved = {"size": list(projector.size), "lattice": projector.lattice.value}
    return {"name": "synthetic", "resolved": {"projector": resolved}}
