"""A camera, a projector, and what they would see of a board with perfect detection."""

from collections.abc import Sequence

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.characterisation import Observation
from fpplab.characterisation.parameters import Solution, vectors_of
from fpplab.core import config
from fpplab.core.conventions import Lattice
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.targets import Target
from tests.support.boards import pose

BOARD = config.validate(
    {"kind": "circles", "size_mm": [60, 42], "counts": [13, 4], "spacing_mm": [4.5, 9],
     "staggered": True, "diameter_mm": 3, "foreground": 0.9, "background": 0.3},
    Target, "board.yaml",
)  # fmt: skip

CAMERA = Pinhole.from_focal((1200, 900), (2200, 2195), (610, 440), (-0.09, 0.12, 5e-4, -3e-4, 0))
SQUARE = Pinhole.from_focal((1824, 1140), (2600, 2605), (860, 1125), (-0.05, 0.02, 2e-4, 1e-4, 0))
DIAMOND = Pinhole.from_focal((912, 1140), (1300, 2600), (450, 1135), (-0.05, 0.02, 0, 0, 0), Lattice.DIAMOND)
PAIR = RigidTransform.from_vectors(np.radians([4.0, 18.0, 1.0]), np.array([-80.0, 60.0, 15.0]))


def poses(count: int, seed: int = 0) -> list[RigidTransform]:
    random = np.random.default_rng(seed)
    tilts = random.uniform(-35, 35, (count, 3))
    places = random.uniform((-30, -20, 220), (30, 20, 280), (count, 3))
    return [pose(tuple(t), tuple(p)) for t, p in zip(tilts, places, strict=True)]  # type: ignore[arg-type]


def observed(
    T_camera_board: Sequence[RigidTransform],
    projector: Pinhole = SQUARE,
    noise_px: float = 0.0,
    points: np.ndarray | None = None,
    seed: int = 1,
) -> list[Observation]:
    """What perfect detection would give, with Gaussian noise on every coordinate."""
    random = np.random.default_rng(seed)
    board = BOARD.points() if points is None else points
    found = []
    for k, transform in enumerate(T_camera_board):
        seen = transform.apply(board)
        camera, light = CAMERA.project(seen), projector.project(seen, PAIR)
        noise = random.normal(0, noise_px, (2, *camera.shape)) if noise_px else np.zeros((2, 1, 1))
        found.append(Observation(f"pose_{k}", np.arange(len(board)), camera + noise[0], light + noise[1]))
    return found


NAMES = {
    "device": ["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"],
    "pair": ["rx", "ry", "rz", "x", "y", "z"],
}


def values(calibration: Calibration) -> dict[str, float]:
    named = {}
    for name, device in (("camera", calibration.camera), ("projector", calibration.projector)):
        k = device.matrix
        terms = [k[0, 0], k[1, 1], k[0, 2], k[1, 2], *device.distortion[:4]]
        named |= {f"{name}.{t}": v for t, v in zip(NAMES["device"], terms, strict=True)}
    transform = vectors_of(calibration.T_projector_camera)
    return named | {f"T_projector_camera.{t}": v for t, v in zip(NAMES["pair"], transform, strict=True)}


def truth_of(held: Sequence[RigidTransform]) -> Solution:
    """What a joint adjustment of `observed(held)` should find."""
    devices = [
        np.array([d.matrix[0, 0], d.matrix[1, 1], d.matrix[0, 2], d.matrix[1, 2], *d.distortion])
        for d in (CAMERA, SQUARE)
    ]
    return Solution(*devices, vectors_of(PAIR), np.stack([vectors_of(t) for t in held]), BOARD.points())
