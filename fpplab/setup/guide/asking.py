"""How a pose is asked for: by a transform from a robot, by text and a sketch from a person."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from fpplab.characterisation.guide import WantedPose
from fpplab.characterisation.parameters import ImageSize
from fpplab.core.errors import CapabilityError
from fpplab.core.files import write_parts
from fpplab.core.geometry import RigidTransform
from fpplab.devices import Fixture, InstructableFixture, PosableFixture

PICTURE = "next_pose.png"  # name of the sketch in the folder of the poses

OUTLINE, TOP, INK = (60, 200, 255), (70, 110, 255), (255, 255, 255)
"""Colours of the outline, of the board's upper edge, and of text: blue, green, red."""

Bring = Callable[[WantedPose, Path], None]  # brings the board into the pose asked for, which a sketch shows


def bring_by(fixture: Fixture, item: str) -> Bring:
    if isinstance(fixture, PosableFixture):
        return lambda pose, _: _place(fixture, item, pose)
    if isinstance(fixture, InstructableFixture):
        return lambda pose, picture: fixture.instruct(
            item, pose.description, picture if picture.is_file() else None
        )
    raise CapabilityError(
        fixture.name,
        "characterise --guide",
        "can neither take a pose nor show instructions",
        "leave --guide out, or use 'fpplab.devices.operator:Operator' as the fixture",
    )


def held_first_pose(fixture: Fixture, item: str) -> RigidTransform | None:
    return fixture.pose(item, 0) if isinstance(fixture, PosableFixture) else None


def _place(fixture: PosableFixture, item: str, pose: WantedPose) -> None:
    if pose.T_camera_target is None:  # nothing is known yet: a pose of the fixture's own
        fixture.mount(item, 0)
    else:
        fixture.place(item, pose.T_camera_target)


def write_sketch(
    path: Path, pose: WantedPose, size: ImageSize, image: NDArray[Any] | None = None, width_px: int = 960
) -> None:
    # size (width, height) px; image (height, width)
    scale = width_px / size[0]
    picture = np.full((round(scale * size[1]), width_px, 3), 40, np.uint8)
    if image is not None:
        grey = cv2.resize(
            np.asarray(image, np.float32), (width_px, len(picture)), interpolation=cv2.INTER_AREA
        )
        grey = np.clip(0.6 * 255 * grey / max(float(np.percentile(grey, 99.5)), 1e-9), 0, 255)
        picture[:] = grey.astype(np.uint8)[..., None]
    if pose.outline_px is not None:
        _draw_outline(picture, scale * (pose.outline_px + 0.5))
    _draw_text(picture, pose.description)
    done, encoded = cv2.imencode(".png", picture)
    assert done
    write_parts(path, encoded.tobytes())


def _draw_outline(picture: NDArray[Any], outline: NDArray[Any]) -> None:
    shift = 4  # binary places of the coordinates
    fine = np.rint(2**shift * outline).astype(np.int32)
    cv2.polylines(picture, [fine], True, OUTLINE, 2, cv2.LINE_AA, shift)
    quarter = len(fine) // 4
    cv2.polylines(picture, [fine[: quarter + 1]], False, TOP, 4, cv2.LINE_AA, shift)
    middle = outline[quarter // 2]
    cv2.putText(picture, "upper edge", (int(middle[0]) - 45, int(middle[1]) - 10), cv2.FONT_HERSHEY_SIMPLEX,
                0.5, TOP, 1, cv2.LINE_AA)  # fmt: skip


def _draw_text(picture: NDArray[Any], text: str) -> None:
    clauses = text.split(", ")
    for k, clause in enumerate(clauses):
        place = (12, len(picture) - 12 - 22 * (len(clauses) - 1 - k))
        cv2.putText(picture, clause, place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0), 4, cv2.LINE_AA)
        cv2.putText(picture, clause, place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, INK, 1, cv2.LINE_AA)
