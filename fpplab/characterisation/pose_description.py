"""A pose of a board in words for the person who holds it, and as an outline in the camera's image."""

import numpy as np

from fpplab.characterisation.candidate_poses import TILT_DEG
from fpplab.characterisation.coverage import REGION_NAMES
from fpplab.core.conventions import Floats
from fpplab.core.geometry import Pinhole, RigidTransform

FACING_DEG, TURNED_DEG, SAME_MM = 5.0, 20.0, 3.0
"""Tilt, turn and change of distance below which none is stated. Chosen: a hand does not hold it better."""

EDGES = (
    "right edge", "lower right corner", "lower edge", "lower left corner",
    "left edge", "upper left corner", "upper edge", "upper right corner",
)  # fmt: skip
"""As the camera sees the board, clockwise."""

FIRST_POSE = (
    "in the middle of the image, where parts will be measured, upper edge tilted away by about "
    f"{TILT_DEG:.0f} degrees"
)
"""The first pose, before anything is known."""


def describe_pose(pose: RigidTransform, camera: Pinhole, first_mm: float) -> str:
    u, v = camera.project(pose.translation)
    column, row = (int(np.clip(3 * (x + 0.5) / n, 0, 2)) for x, n in zip((u, v), camera.size, strict=True))
    parts = [
        f"in the {REGION_NAMES[row][column]} of the image",
        _describe_distance(float(pose.translation[2]), first_mm),
    ]
    return ", ".join([*parts, _describe_tilt(pose), *_describe_turn(pose)])


def outline_px(pose: RigidTransform, camera: Pinhole, size_mm: tuple[float, float]) -> Floats:
    # size_mm (width, height) mm; returns (40, 2) px
    x, y = 0.5 * size_mm[0], 0.5 * size_mm[1]
    corners = np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0]])
    steps = np.linspace(0, 1, 11)[:-1, None]
    sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
    return camera.project(pose.apply(np.concatenate([a + steps * (b - a) for a, b in sides])))


def _describe_distance(z: float, first_mm: float) -> str:
    difference = z - first_mm
    if abs(difference) < SAME_MM:
        return f"as far as the first pose ({z:.0f} mm from the camera)"
    direction = "farther" if difference > 0 else "nearer"
    return f"{abs(difference):.0f} mm {direction} than the first pose ({z:.0f} mm)"


def _describe_tilt(pose: RigidTransform) -> str:
    across, down, along = pose.rotation[:, 2]
    tilt = float(np.degrees(np.arccos(np.clip(along, -1.0, 1.0))))
    if tilt < FACING_DEG:
        return "facing the camera"
    # The depth of the plane grows against the normal's part in the image.
    octant = round(float(np.degrees(np.arctan2(-down, -across))) / 45.0) % 8
    return f"{EDGES[octant]} tilted away by {tilt:.0f} degrees"


def _describe_turn(pose: RigidTransform) -> list[str]:
    turn = float(np.degrees(np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0])))
    if abs(turn) < TURNED_DEG:
        return []
    return [f"turned by {abs(turn):.0f} degrees {'clockwise' if turn > 0 else 'counterclockwise'}"]
