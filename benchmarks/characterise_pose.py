"""Characterisation of a rig by poses of a board, beside a straightforward pipeline of NumPy and OpenCV.

Sessions of 32 frames lie complete on disk, in the page cache. The product reads and checks them, decodes,
finds the board, fits every point in camera and projector, adjusts all poses jointly, estimates all errors,
repeats the fit without each pose, and tests its own uncertainty. The baseline reads the same files, decodes
them as one writes it down, finds the board by OpenCV with its refinement of corners, looks the coordinates up
at the nearest four pixels, and calls OpenCV's calibration of both devices and of the pair.
"""

import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from benchmarks import Result, below
from benchmarks.last_frame_to_cloud import rig_record
from fpplab.calibration.model import Calibration
from fpplab.core.conventions import TWO_PI, Floats, Map, axis_length
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.devices import CameraSettings, Frame
from fpplab.patterns.plan import Plan
from fpplab.pipeline.characterising import characterise_sessions
from fpplab.reconstruction.triangulation import camera_slopes
from fpplab.sessions.session import Session
from fpplab.targets import Target

POSES = 10
SIZE = 1280, 960
PROJECTOR = 912, 1140
BOARDS = {"circles": ("target_paper", 250.0), "checkerboard": ("target_checkerboard", 680.0)}
"""Board and its distance in mm."""

MOST_S = 1.0
"""An operator shall wait at most so long for each pose."""

PX_PER_MM = 12.0
PLAN = Plan.load("plan_board")


def run() -> list[Result]:
    """Measure both kinds of board; two minutes on two cores."""
    return [result for kind in BOARDS for result in characterisation_figures(kind)]


def characterisation_figures(kind: str, poses: int = POSES) -> list[Result]:
    """Measure one kind of board, product and baseline in turn."""
    name, distance_mm = BOARDS[kind]
    target = Target.load(name)
    with tempfile.TemporaryDirectory(prefix="fpplab-bench-") as folder:
        sessions = [
            record_pose(Path(folder) / f"pose_{k:02d}", target, pose)
            for k, pose in enumerate(tilted(poses, distance_mm))
        ]
        characterise_sessions(sessions[:4], target)  # compiles, and fills the page cache
        begin = time.perf_counter()
        characterise_sessions(sessions, target)
        between = time.perf_counter()
        opencv_characterisation(sessions, target)
        end = time.perf_counter()
    ours, theirs = (between - begin) / poses, (end - between) / poses
    beside = Result(f"characterise_pose_{kind}", ours, "s", theirs, theirs / ours)
    return [beside, below(f"{beside.name}_most", ours, "s", MOST_S)]


def rig() -> Calibration:
    """Make the rig that takes the poses."""
    camera = Pinhole.from_focal(SIZE, (2600.0, 2598.0), (645.0, 470.0), (-0.08, 0.1, 4e-4, -3e-4, 0))
    projector = Pinhole.from_focal(PROJECTOR, (1700.0, 1702.0), (450.0, 590.0), (-0.03, 0.05, 2e-4, 3e-4, 0))
    turn = RigidTransform.from_vectors(np.array([0.01, -0.22, 0.005]), np.zeros(3))
    place = np.array([-120.0, 4.0, 6.0])
    return Calibration(camera, projector, RigidTransform(turn.rotation, -turn.rotation @ place), {})


def tilted(count: int, distance_mm: float) -> list[RigidTransform]:
    """Draw poses of a board that both devices see whole."""
    random = np.random.default_rng(4)
    tilts = np.radians(random.uniform(-28, 28, (count, 3)) * [1, 1, 0.4])
    places = distance_mm * random.uniform((-0.03, -0.03, 0.97), (0.03, 0.03, 1.05), (count, 3))
    return [RigidTransform.from_vectors(t, p) for t, p in zip(tilts, places, strict=True)]


def record_pose(path: Path, target: Target, pose: RigidTransform) -> Session:
    """Record what the camera sees of a board, blurred, with noise of about one grey level."""
    calibration = rig()
    across, down = camera_slopes(calibration.camera)
    rays = np.stack([across, down, np.ones_like(across)], axis=-1)
    normal = pose.rotation[:, 2]
    points = rays * (normal @ pose.translation / (rays @ normal))[..., None]
    on_board = (points - pose.translation) @ pose.rotation
    picture = cv2.GaussianBlur(target.image(PX_PER_MM).astype(np.float32) / 255.0, (0, 0), 1.0)
    height, width = picture.shape
    across, down = (
        (PX_PER_MM * on_board[..., k] + 0.5 * (n - 1)).astype(np.float32)
        for k, n in enumerate((width, height))
    )
    ink = cv2.remap(picture, across, down, cv2.INTER_LINEAR, borderValue=(0.02,))
    seen = calibration.projector.project(points, calibration.T_projector_camera)
    session = Session.create(path, PLAN, rig_record(calibration))
    random = np.random.default_rng([7, len(path.name), int(path.name[-2:])])
    for index, (k, step, name) in enumerate(PLAN.steps()):
        fringe = PLAN.fringes[k]
        position = (seen[..., "xy".index(fringe.axis)] + 0.5) / axis_length(PROJECTOR, fringe.axis)
        wave = np.cos(TWO_PI * (fringe.stripes * position - step / fringe.images))
        level = cv2.GaussianBlur((ink * (115.0 + 95.0 * wave)).astype(np.float32), (0, 0), 0.7)
        image = np.rint(level + 6.0 + random.normal(0.0, 1.0, level.shape)).clip(0, 255).astype(np.uint8)
        settings = CameraSettings(PLAN.exposure_s, 0.0, 8)
        session.write(Frame(image, index, settings, time.time(), pattern_id=name))
    return session


def opencv_characterisation(sessions: Sequence[Session], target: Target) -> Floats:
    """Read, decode, find the board and calibrate as one writes it down: the baseline."""
    # returns (3,) mm
    board, cameras, projectors = target.points().astype(np.float32), [], []
    for session in sessions:
        files = [session.path / session.record(i).file for i in range(PLAN.images)]
        frames = np.stack([cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in files])
        maps, grey = _decoded(frames.astype(np.float32))
        corners = _found(grey, target)
        cameras.append(corners)
        looked_up = [cv2.remap(m, corners, None, cv2.INTER_LINEAR) for m in maps]  # type: ignore[call-overload]
        projectors.append(np.stack(looked_up, axis=-1).reshape(-1, 1, 2))
    boards = [board] * len(cameras)
    devices = [
        cv2.calibrateCamera(boards, seen, size, None, None)[1:3]  # type: ignore[call-overload]
        for seen, size in ((cameras, SIZE), (projectors, PROJECTOR))
    ]
    (camera, lens), (projector, other) = devices
    return np.asarray(
        cv2.stereoCalibrate(boards, cameras, projectors, camera, lens, projector, other, SIZE)[6], np.float64
    ).ravel()


def _decoded(frames: Map) -> tuple[list[Map], Map]:
    """Projector coordinates along both axes, and the mean image."""
    maps, first = [], 0
    for axis in PLAN.axes:
        absolute, stripes = None, 1.0
        for fringe in (f for f in PLAN.fringes if f.axis == axis):
            steps, first = frames[first : first + fringe.images], first + fringe.images
            angle = TWO_PI * np.arange(len(steps), dtype=np.float32) / len(steps)
            sine, cosine = (np.tensordot(f(angle), steps, axes=1) for f in (np.sin, np.cos))
            phase = np.mod(np.arctan2(sine, cosine), TWO_PI)
            if absolute is not None:
                expected = absolute * (fringe.stripes / stripes)
                phase = phase + TWO_PI * np.round((expected - phase) / TWO_PI)
            absolute, stripes = phase, fringe.stripes
        assert absolute is not None
        maps.append((absolute * (axis_length(PROJECTOR, axis) / (TWO_PI * stripes)) - 0.5).astype(np.float32))
    return maps, frames.mean(axis=0)


def _found(grey: Map, target: Target) -> Map:
    """Points (K, 1, 2) of the board in the order of their ids."""
    image = cv2.normalize(grey, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)  # type: ignore[call-overload]
    columns, rows = target.counts
    if target.kind == "circles":
        flags = cv2.CALIB_CB_ASYMMETRIC_GRID
        settings = cv2.SimpleBlobDetector.Params()
        settings.maxArea = 1e5
        found, pixels = cv2.findCirclesGrid(
            image, (rows, columns), flags=flags, blobDetector=cv2.SimpleBlobDetector.create(settings)
        )
        grid = np.asarray(pixels, np.float32).reshape(columns, rows, 2).transpose(1, 0, 2)
    else:
        found, pixels = cv2.findChessboardCorners(image, (columns, rows))
        criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
        pixels = cv2.cornerSubPix(image, np.asarray(pixels, np.float32), (11, 11), (-1, -1), criteria)
        grid = np.asarray(pixels, np.float32).reshape(rows, columns, 2)
    assert found
    turned = grid[::-1, ::-1] if grid[0, -1, 0] < grid[0, 0, 0] else grid
    return np.ascontiguousarray(turned.reshape(-1, 1, 2))
