"""Part of a board: found with its own ids where that is certain, refused with the reason where not."""

import re
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from fpplab.characterisation.observation import observe
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import RigidTransform
from fpplab.targets import Target, UnclearPart
from fpplab.targets.partial import detect_part
from fpplab.targets.views import Detection
from tests.support.boards import plane_homography, pose, render
from tests.targets.test_targets import CAMERA, CIRCLES, CORNERS, MARKED, SIZE, board, noisy, truth

EVEN = {"kind": "circles", "size_mm": [80, 62], "counts": [7, 5], "spacing_mm": [11, 11], "diameter_mm": 5}
ODD = {**CORNERS, "counts": [7, 4]}
BOARDS = {"staggered": CIRCLES, "even": EVEN, "checkerboard": CORNERS, "odd checkerboard": ODD}
KINDS = pytest.mark.parametrize("kind", list(BOARDS))
VIEWS = {
    "left half": pose((0, 0, 0), (45, 0, 150)),
    "right half": pose((20, -25, 0), (-45, 0, 150)),
    "turned": pose((20, -25, 90), (0, 40, 150)),
}
UP = pose((0, 0, 0), (0, -30, 150))
"""The upper rows of the board of circles are out of the picture."""


@cache
def rendered(target: Target, view: RigidTransform, ground: float) -> np.ndarray:
    return np.rint(render(target, plane_homography(CAMERA, view), SIZE, ground=ground))


def taken(target: Target, view: RigidTransform, ground: float = 0.3) -> np.ndarray:
    return rendered(target, view, ground).copy()


def part_of(target: Target, image: np.ndarray) -> Detection | None:
    return target.detect(image) or detect_part(target.layout, image)


def dim(kind: str, **changes: object) -> Target:
    return board(BOARDS[kind], foreground=0.1, background=0.8, **changes)


def outcome(target: Target, picture: np.ndarray) -> str:
    try:
        return "something" if part_of(target, picture) else "nothing"
    except UnclearPart as refusal:
        return str(refusal)


def well_inside(points: np.ndarray, margin: float) -> np.ndarray:
    return ((points > margin) & (points < np.array(SIZE) - margin)).all(axis=1)


@pytest.mark.whole_after(1)
@KINDS
@pytest.mark.parametrize("view", list(VIEWS))
def test_points_in_view_keep_their_ids(kind: str, view: str) -> None:
    target = dim(kind)
    expected = truth(target, plane_homography(CAMERA, VIEWS[view]))
    picture = taken(target, VIEWS[view])
    assert target.detect(picture) is None
    found = part_of(target, picture)
    assert found is not None
    assert len(found.ids) < len(expected)
    np.testing.assert_allclose(found.pixels, expected[found.ids], atol=0.02)
    assert set(np.flatnonzero(well_inside(expected, 45))) <= set(found.ids.tolist())


@pytest.mark.whole_after(1)
@KINDS
def test_noise_does_not_change_what_is_what(kind: str) -> None:
    target = dim(kind)
    expected = truth(target, plane_homography(CAMERA, VIEWS["left half"]))
    found = part_of(target, noisy(taken(target, VIEWS["left half"]), 4.0))
    assert found is not None
    np.testing.assert_allclose(found.pixels, expected[found.ids], atol=0.08)


@pytest.mark.whole_after(2)
@KINDS
def test_a_whole_board_is_found_whole(kind: str) -> None:
    target = dim(kind)
    view = pose((15, -20, 5), (0, 0, 200))
    found = part_of(target, taken(target, view))
    assert found is not None
    np.testing.assert_array_equal(found.ids, np.arange(len(target.points())))


@pytest.mark.whole_after(1)
@KINDS
def test_a_middle_without_ends_could_be_anywhere(kind: str) -> None:
    with pytest.raises(UnclearPart, match=r"could be any of \d+ parts of it; show a corner"):
        part_of(dim(kind), taken(dim(kind), pose((0, 0, 0), (0, 0, 60))))


@pytest.mark.whole_after(2)
@pytest.mark.parametrize("level", [26, 77, 150, 204, 255])
@pytest.mark.parametrize("from_row", [100, 112])
def test_what_hides_a_row_does_not_pass_for_the_boards_end(from_row: int, level: int) -> None:
    target = dim("staggered")
    picture = taken(target, UP)
    assert part_of(target, picture) is not None
    picture[from_row:] = level  # between the second row in view and the third
    with pytest.raises(UnclearPart, match="its edge included"):
        part_of(target, picture)


@pytest.mark.whole_after(2)
@KINDS
@pytest.mark.parametrize("level", [26, 204])
def test_a_point_that_is_hidden_is_not_passed_over(kind: str, level: int) -> None:
    target = dim(kind)
    picture = taken(target, VIEWS["left half"])
    expected = truth(target, plane_homography(CAMERA, VIEWS["left half"]))
    u, v = expected[np.flatnonzero(well_inside(expected, 60))[-1]].astype(int)
    picture[v - 22 : v + 23, u - 22 : u + 23] = level
    assert re.search("unobstructed|any of|nothing", outcome(target, picture))


def test_without_a_contrast_to_what_is_behind_it_a_boards_end_is_not_known() -> None:
    target = dim("staggered")
    assert part_of(target, taken(target, UP, ground=0.3)) is not None
    with pytest.raises(UnclearPart, match="in front of something darker"):
        part_of(target, taken(target, UP, ground=0.8))


@pytest.mark.whole_after(3)
@pytest.mark.parametrize(
    ("real", "said"),
    [
        ("staggered", {"staggered": False, "size_mm": [70, 50]}),
        ("staggered", {"counts": [4, 13], "size_mm": [60, 142]}),
        ("even", {"counts": [6, 5]}),
        ("even", {"staggered": True, "size_mm": [90, 90]}),
        ("checkerboard", {"counts": [7, 4]}),
        ("odd checkerboard", {"counts": [7, 5]}),
    ],
)
@pytest.mark.parametrize("view", list(VIEWS))
def test_a_board_described_wrongly_is_no_part_of_itself(
    real: str, said: dict[str, object], view: str
) -> None:
    picture = taken(dim(real), VIEWS[view])
    with pytest.raises(UnclearPart, match="correct its description"):
        part_of(dim(real, **said), picture)


@pytest.mark.whole
@pytest.mark.parametrize("kind", ["staggered", "checkerboard"])
def test_nothing_is_no_part(kind: str) -> None:
    assert part_of(dim(kind), np.zeros(SIZE[::-1], np.uint8)) is None
    assert part_of(dim(kind), noisy(np.full(SIZE[::-1], 100.0), 5.0)) is None


def test_part_of_a_charuco_board_needs_neither_ends_nor_edges() -> None:
    target = board(MARKED, foreground=0.1, background=0.8)
    view = pose((10, 5, 0), (0, 0, 75))
    found = part_of(target, taken(target, view))
    assert found is not None
    expected = truth(target, plane_homography(CAMERA, view))
    assert len(found.ids) < len(expected)
    np.testing.assert_allclose(found.pixels, expected[found.ids], atol=0.05)


def decoded() -> SimpleNamespace:
    """A projector that looks at every board from where the camera is."""
    v, u = np.mgrid[0 : SIZE[1], 0 : SIZE[0]].astype(np.float32)
    return SimpleNamespace(u=u, v=v, modulation=np.full(u.shape, 50, np.float32))


def test_a_pose_may_show_part_of_the_board() -> None:
    target = dim("staggered")
    seen = observe("pose 3", taken(target, VIEWS["left half"]), decoded(), target)  # type: ignore[arg-type]
    expected = truth(target, plane_homography(CAMERA, VIEWS["left half"]))[seen.ids]
    np.testing.assert_allclose(seen.camera_px, expected, atol=0.02)
    np.testing.assert_allclose(seen.projector_px, expected, atol=0.02)


def test_a_pose_of_an_unclear_part_is_named_with_the_reason() -> None:
    target = dim("staggered")
    with pytest.raises(CalibrationError, match=r"pose 3: the board was not found .*: \d+ points .*any of"):
        observe("pose 3", taken(target, pose((0, 0, 0), (0, 0, 60))), decoded(), target)  # type: ignore[arg-type]
