"""Derivatives of what pixels see: against central differences of the places themselves."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Floats
from fpplab.core.geometry import Pinhole, RigidTransform
from sim.matching.geometry.surface_points import surface_and_projector_jacobian, surface_and_projector_points
from tests.support.plane_twin import CAMERA, PAIR, PROJECTOR, tilted

TERMS = 12
RATIONAL = np.array([-0.08, 0.1, 4e-4, -3e-4, 0.01, 0.02, -0.01, 0.01])
KNOWN = Calibration(replace(CAMERA, distortion=RATIONAL), replace(PROJECTOR, distortion=RATIONAL), PAIR, {})
POSE = tilted(2)[1]
Change = Callable[[float], tuple[Calibration, RigidTransform]]


def _with_term(device: Pinhole, term: int, by: float) -> Pinhole:
    if term >= 4:
        return replace(device, distortion=device.distortion + by * (np.arange(8) == term - 4))
    place = ((0, 0), (1, 1), (0, 2), (1, 2))[term]
    matrix = device.matrix.copy()
    matrix[place] += by
    return replace(device, matrix=matrix)


def _moved(pose: RigidTransform, part: int, by: float) -> RigidTransform:
    turn, shift = by * np.eye(6)[part, :3], by * np.eye(6)[part, 3:]
    turned = RigidTransform.from_vectors(turn, np.zeros(3)).rotation @ pose.rotation
    return RigidTransform(turned, pose.translation + shift)


def _changes() -> list[Change]:
    """In the order of the columns."""

    def camera(term: int) -> Change:
        return lambda by: (replace(KNOWN, camera=_with_term(KNOWN.camera, term, by)), POSE)

    def projector(term: int) -> Change:
        return lambda by: (replace(KNOWN, projector=_with_term(KNOWN.projector, term, by)), POSE)

    def pair(part: int) -> Change:
        return lambda by: (replace(KNOWN, T_projector_camera=_moved(PAIR, part, by)), POSE)

    def board(part: int) -> Change:
        return lambda by: (KNOWN, _moved(POSE, part, by))

    devices = [make(term) for make in (camera, projector) for term in range(TERMS)]
    return devices + [make(part) for make in (pair, board) for part in range(6)]


def _differences(pixels: Floats, change: Change, step: float) -> Floats:
    ends = [surface_and_projector_points(pixels, *change(by)) for by in (step, -step)]
    return np.asarray((ends[0] - ends[1]) / (2 * step))


def test_derivatives_agree_with_central_differences() -> None:
    pixels = np.random.default_rng(0).uniform((100, 80), (350, 220), (50, 2))
    found = surface_and_projector_jacobian(pixels, KNOWN, POSE, TERMS)
    changes = _changes()
    assert found.shape == (50, 4, len(changes))
    for column, change in enumerate(changes):
        # Two steps, so that what is left of the third derivative is a sixteenth: Richardson.
        step = 1e-4 if column % TERMS >= 4 or column >= 2 * TERMS else 1e-2
        fine, coarse = _differences(pixels, change, step), _differences(pixels, change, 2 * step)
        wanted = (4 * fine - coarse) / 3
        # the camera's lens is inverted to 1e-10 px, and that is divided by the step
        tolerance = 1e-8 * np.abs(wanted).max() + 1e-10 / step
        np.testing.assert_allclose(found[..., column], wanted, atol=tolerance)
