"""`python -m tests.support.warmup`: compile the kernels once, so that no measurement waits for it.

A small plane is encoded, decoded, triangulated and compared, a board is found, the twin sees its board, and a
measurement is predicted; numba keeps what it compiled next to the sources. The set-up runs this, and after a
change of the sources the next measurement does.
"""

import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import trimesh

from fpplab.calibration.model import Calibration
from fpplab.characterisation import Observation, observe
from fpplab.clouds import local_quadric_distance
from fpplab.comparison import compare
from fpplab.core.conventions import (
    Floats,
    Image,
    Lattice,
    axis_length,
    full_scale,
    phase_of_coordinate,
    raw_dtype,
)
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.devices.rig import Rig
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import Decoded, decode
from fpplab.phase.exposures import merged_recording
from fpplab.reconstruction.points import points_of
from fpplab.targets import Target
from sim.bench import VirtualBench
from sim.prediction import predict

DISTANCE_MM = 400.0  # of the plane from the camera (chosen)
SIZE = 96, 64


def small_rig() -> Calibration:
    camera = Pinhole.from_focal(SIZE, (200.0, 200.0), (47.5, 31.5), (0.01, 0.0, 0.0, 0.0, 0.0))
    projector = Pinhole.from_focal((912, 1140), (1100.0, 2200.0), (455.5, 569.5))
    turned = RigidTransform.from_vectors(np.array([0.0, -0.24, 0.0]), np.array([100.0, 0.0, 0.0]))
    return Calibration(camera, projector, turned.inverse(), {})


def frames_of_plane(plan: Plan, rig: Calibration, bits: int) -> list[Image]:
    """Compute what the camera sees of a plane under a plan's fringes, without noise."""
    # returns (height, width)
    u, v = np.meshgrid(np.arange(SIZE[0], dtype=float), np.arange(SIZE[1], dtype=float))
    slopes = rig.camera.normalise(np.stack([u, v], axis=-1))
    points = DISTANCE_MM * np.concatenate([slopes, np.ones((*slopes.shape[:2], 1))], axis=-1)
    coordinates = rig.projector.project(points, rig.T_projector_camera)
    return [_simulate_frame(plan, i, n, coordinates, rig.projector.size, bits) for i, n, _ in plan.steps()]


def _simulate_frame(
    plan: Plan, index: int, step: int, coordinates: Floats, size: tuple[int, int], bits: int
) -> Image:
    fringe = plan.fringes[index]
    coordinate = coordinates[..., 0 if fringe.axis == "x" else 1]
    phase = phase_of_coordinate(coordinate, fringe.stripes, axis_length(size, fringe.axis))
    level = 0.1 + 0.8 * fringe.wave(phase, step)
    image: Image = np.rint(level * full_scale(bits)).astype(raw_dtype(bits))
    return image


def observe_board() -> Observation:
    """Find a board seen from the front, where the projector's pixels are the camera's."""
    board = Target.load("target_paper.yaml")
    image = np.pad(board.image(px_per_mm=8.0), 40, constant_values=80)
    v, u = np.indices(image.shape, np.float32)
    return observe("board", image, Decoded(u, v, image.astype(np.float32), np.zeros_like(u)), board)


def measure_plane(plan: Plan) -> int:
    rig = small_rig()
    for bits in (16, 8):
        frames = frames_of_plane(plan, rig, bits)
        for frame in frames if bits == 16 else ():  # with an edge in depth
            frame[:, : SIZE[0] // 2] = frame[:, SIZE[0] // 2 :]
        decoded: Decoded = decode(Recording(frames, plan, rig.projector.size, bits))
    _, cloud = points_of(decoded, rig, plan)
    local_quadric_distance(cloud)
    plate = trimesh.creation.box((300.0, 200.0, 10.0))
    plate.apply_translation((0.0, 0.0, DISTANCE_MM + 5.0))
    compare(cloud, plate, rig, density=0.5)
    return len(cloud)


def decode_code() -> Decoded:
    """Decode a code that was taken at two exposures, from images as the projector shows them."""
    fringes = ({"kind": "gray", "axis": "x", "bits": 5, "cell_px": 3.0}, {"kind": "even", "levels": (1, 0)})
    plan = Plan.model_validate({"fringes": fringes, "exposures_s": (0.01, 0.02)})
    noise = np.random.default_rng(0)
    frames: list[Image] = [
        np.rint(20.0 + share * pattern.image + noise.normal(0.0, 1.0, SIZE[::-1])).astype(np.uint8)
        for share in (0.4, 0.8)
        for pattern in make_patterns(plan, SIZE, Lattice.SQUARE)
    ]
    merged = merged_recording(Recording(frames, plan, SIZE), plan.exposures)
    return decode(merged)


def see_boards(plan: Plan) -> None:
    observe_board()
    decode_code()
    with Rig.load("rig_matched") as twin:
        assert isinstance(twin.simulation, VirtualBench)
        patterns = make_patterns(plan, small_rig().projector.size, Lattice.SQUARE)[:1]
        pixels = np.arange(2), np.arange(2)
        twin.simulation.twin("board").expected_at(0, patterns, twin.camera_settings(0.02), pixels)


def warm_up() -> int:
    """Run every compiled kernel once, for every type that measurements use, in two processes side by side."""
    plan = Plan.load("plan_paper.yaml")
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as beside:
        boards = beside.submit(see_boards, plan)
        points = measure_plane(plan)
        boards.result()
    with Rig.load("rig_matched") as twin:  # what remains, for this measures as well
        predict(twin, plan, "pyramid", pixels=2000)
    return points


if __name__ == "__main__":
    sys.stderr.write("fpplab: compiling …\n")
    warm_up()
