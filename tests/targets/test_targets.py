"""Boards: their points, their pictures, and finding them again."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.core import config
from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.targets import Target
from fpplab.targets.kinds.charuco import CharucoLayout
from fpplab.targets.kinds.circles import CircleGrid
from fpplab.targets.views import Detection, apply_homography, eccentricity, homography, homography_jacobians
from tests.support.boards import plane_homography, pose, render

CIRCLES = {"kind": "circles", "size_mm": [60, 42], "counts": [13, 4], "spacing_mm": [4.5, 9],
           "staggered": True, "diameter_mm": 3}  # fmt: skip
CORNERS = {"kind": "checkerboard", "size_mm": [100, 80], "counts": [7, 5], "spacing_mm": [10, 10]}
MARKED = {"kind": "charuco", "size_mm": [80, 60], "counts": [6, 4], "spacing_mm": [10, 10],
          "marker_mm": 7, "dictionary": "4x4_50"}  # fmt: skip
KINDS = pytest.mark.parametrize("fields", [CIRCLES, CORNERS, MARKED], ids=lambda f: f["kind"])

SIZE = (640, 480)
CAMERA = Pinhole.from_focal(SIZE, (900.0, 900.0), (322.0, 236.0))
VIEWS = {
    "frontal": pose((0, 0, 0), (1.3, -0.7, 150)),
    "tilted": pose((30, -20, 15), (2, 1, 160)),
    "steep": pose((-10, 42, -30), (0, 0, 170)),
}


def board(fields: dict[str, object], **changes: object) -> Target:
    return config.validate({**fields, **changes}, Target, "board.yaml")


def charuco_model(target: Target) -> cv2.aruco.CharucoBoard:
    assert isinstance(target.layout, CharucoLayout)
    return target.layout.model()


def truth(target: Target, matrix: np.ndarray) -> np.ndarray:
    return apply_homography(matrix, target.points()[:, :2])


def noisy(picture: np.ndarray, sigma: float, seed: int = 1) -> np.ndarray:
    levels = picture + np.random.default_rng(seed).normal(0, sigma, picture.shape)
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


# Points


def test_points_are_centred_and_run_row_by_row() -> None:
    points = board(CORNERS).points()
    assert points.shape == (35, 3)
    assert points.dtype == np.float64
    np.testing.assert_allclose(points[0], [-30, -20, 0])
    np.testing.assert_allclose(points[1], [-20, -20, 0])
    np.testing.assert_allclose(points[7], [-30, -10, 0])
    np.testing.assert_allclose(points.mean(axis=0), 0, atol=1e-12)


def test_every_other_column_of_a_staggered_board_lies_half_a_pitch_lower() -> None:
    grid = board(CIRCLES).points().reshape(4, 13, 3)
    np.testing.assert_allclose(grid[:, 1::2, 1] - grid[:, :-1:2, 1], 4.5)
    np.testing.assert_allclose(np.diff(grid[:, ::2, 1], axis=1), 0)
    np.testing.assert_allclose(np.diff(grid[..., 0], axis=1), 4.5)
    np.testing.assert_allclose(grid[0, 0, :2], [-27, -15.75])


def test_the_board_of_the_paper_has_52_circles_on_60_by_42_mm() -> None:
    target = Target.load("target_paper")
    assert target.size_mm == (60, 42)
    assert len(target.points()) == 52
    assert not target.symmetric


def test_points_of_a_charuco_board_are_those_of_its_model() -> None:
    target = board(MARKED)
    corners = charuco_model(target).getChessboardCorners()
    np.testing.assert_allclose(target.points()[:, :2], corners[:, :2] - (35, 25), atol=1e-5)


@pytest.mark.parametrize(
    ("fields", "changes", "words"),
    [
        (CIRCLES, {"size_mm": [57.5, 42]}, "57.6 mm wide"),
        (CORNERS, {"size_mm": [100, 59]}, "60 mm high"),
        (CIRCLES, {"diameter_mm": 5.4, "size_mm": [70, 50]}, "touch"),
        (CIRCLES, {"diameter_mm": None}, "'diameter_mm' is missing"),
        (CORNERS, {"diameter_mm": 3}, "'diameter_mm' belongs to kind marks or circles"),
        (CORNERS, {"counts": [7, 7]}, "must differ"),
        (CORNERS, {"counts": [7, 2]}, "at least 3"),
        (CORNERS, {"spacing_mm": [10, 9]}, "the same along x and y"),
        (MARKED, {"marker_mm": 10}, "less than the square"),
        (MARKED, {"dictionary": "7x7_9"}, "dictionary"),
        (MARKED, {"dictionary": "4x4_50", "counts": [12, 11], "size_mm": [200, 200]}, "78 markers"),
        (CORNERS, {"foreground": 1.0}, "must differ"),
        (CORNERS, {"foreground": 1.2}, "foreground"),
        (CORNERS, {"kind": "stars"}, "kind"),
    ],
)
def test_a_board_that_cannot_be_is_refused(fields: dict, changes: dict, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        board({k: v for k, v in {**fields, **changes}.items() if v is not None})


# Pictures


@KINDS
def test_a_picture_has_the_size_and_the_levels_of_the_board(fields: dict) -> None:
    target = board(fields, foreground=0.2, background=0.8)
    picture = target.image(8.0)
    assert picture.dtype == np.uint8
    assert picture.shape == (8 * target.size_mm[1], 8 * target.size_mm[0])
    assert picture.min() == 51
    assert picture.max() == 204


@pytest.mark.parametrize("px_per_mm", [5.0, 7.37, 12.0])
def test_the_share_of_ink_is_that_of_the_circles(px_per_mm: float) -> None:
    share = 1 - board(CIRCLES).image(px_per_mm).mean() / 255
    # Antialiased levels are rounded to 1/255 along rims only.
    assert share == pytest.approx(52 * np.pi * 1.5**2 / (60 * 42), rel=2e-3)


@pytest.mark.parametrize("px_per_mm", [2.0, 3.33])
def test_the_share_of_ink_is_that_of_the_squares(px_per_mm: float) -> None:
    share = 1 - board(CORNERS).image(px_per_mm).mean() / 255
    assert share == pytest.approx(24 * 100 / (100 * 80), rel=1e-3)


def test_a_charuco_picture_is_opencvs_own() -> None:
    target = board(MARKED, size_mm=[70, 50], marker_mm=6)
    expected = charuco_model(target).generateImage((700, 500), marginSize=0)
    np.testing.assert_array_equal(target.image(10.0), expected)


# Finding


@pytest.mark.whole_after(2)
@KINDS
@pytest.mark.parametrize("view", VIEWS.values(), ids=VIEWS.keys())
def test_points_are_found_where_they_are(fields: dict, view: object) -> None:
    target = board(fields, foreground=0.1, background=0.8)
    matrix = plane_homography(CAMERA, view)  # type: ignore[arg-type]
    found = target.detect(np.rint(render(target, matrix, SIZE)).astype(np.uint8))
    assert found is not None
    assert len(found.ids) == len(target.points())
    errors = np.linalg.norm(found.pixels - truth(target, matrix)[found.ids], axis=1)
    assert errors.max() < 0.015
    assert np.sqrt(np.mean(errors**2)) < 0.008


@KINDS
def test_noise_moves_points_no_more_than_it_must(fields: dict) -> None:
    target = board(fields, foreground=0.1, background=0.8)
    matrix = plane_homography(CAMERA, VIEWS["tilted"])
    found = target.detect(noisy(render(target, matrix, SIZE), 3.0))
    assert found is not None
    errors = found.pixels - truth(target, matrix)[found.ids]
    # 3 grey levels on edges of about 70 per px, some 20 edge pixels per coordinate: 0.01 px.
    assert np.sqrt(np.mean(errors**2)) < 0.015


@pytest.mark.whole_after(4)
@pytest.mark.parametrize("turn", [0, 90, 180, 270])
@pytest.mark.parametrize("fields", [CIRCLES, {**CORNERS, "counts": [7, 4]}, MARKED], ids=lambda f: f["kind"])
def test_a_board_without_symmetry_keeps_its_ids_however_it_is_turned(fields: dict, turn: int) -> None:
    target = board(fields)
    assert not target.symmetric
    matrix = plane_homography(CAMERA, pose((0, 0, turn), (0, 0, 175)))
    found = target.detect(np.rint(render(target, matrix, SIZE)).astype(np.uint8))
    assert found is not None
    np.testing.assert_allclose(found.pixels, truth(target, matrix)[found.ids], atol=0.03)


@pytest.mark.whole_after(2)
@pytest.mark.parametrize("turn", [20, 110, 200, 290])
def test_a_symmetric_board_points_right_or_down(turn: int) -> None:
    target = board(CORNERS)
    assert target.symmetric
    matrix = plane_homography(CAMERA, pose((0, 0, turn), (0, 0, 190)))
    found = target.detect(np.rint(render(target, matrix, SIZE)).astype(np.uint8))
    assert found is not None
    expected = truth(target, matrix)
    if turn in (200, 290):
        expected = expected[::-1]
    np.testing.assert_allclose(found.pixels, expected, atol=0.03)


def test_part_of_a_charuco_board_suffices() -> None:
    target = board(MARKED, foreground=0.1, background=0.9)
    matrix = plane_homography(CAMERA, VIEWS["tilted"])
    picture = np.rint(render(target, matrix, SIZE)).astype(np.uint8)
    expected = truth(target, matrix)
    cut = int(np.median(expected[:, 0]))
    picture[:, :cut] = 60
    found = target.detect(picture)
    assert found is not None
    assert 6 <= len(found.ids) < len(expected)
    assert np.all(expected[found.ids][:, 0] > cut - 2)
    clear = expected[found.ids][:, 0] > cut + 15
    np.testing.assert_allclose(found.pixels[clear], expected[found.ids][clear], atol=0.03)


def test_bright_circles_on_a_dark_board_are_found() -> None:
    target = board(CIRCLES, foreground=0.9, background=0.1)
    matrix = plane_homography(CAMERA, VIEWS["tilted"])
    found = target.detect(render(target, matrix, SIZE))
    assert found is not None
    np.testing.assert_allclose(found.pixels, truth(target, matrix), atol=0.03)


@KINDS
def test_a_dim_picture_is_no_hindrance(fields: dict) -> None:
    target = board(fields)
    matrix = plane_homography(CAMERA, VIEWS["tilted"])
    found = target.detect(0.1 * render(target, matrix, SIZE))
    assert found is not None
    np.testing.assert_allclose(found.pixels, truth(target, matrix)[found.ids], atol=0.03)


@pytest.mark.whole
def test_a_checkerboard_before_a_black_ground_with_noise_is_found() -> None:
    target = board(CORNERS, counts=[13, 9], size_mm=[160, 120], foreground=0.25, background=0.6)
    size = (844, 676)
    camera = Pinhole.from_focal(size, (1096.0, 1096.0), (416.0, 330.0))
    matrix = plane_homography(camera, pose((0, 0, 0), (0, 0, 420)))
    found = target.detect(noisy(1.0 + 0.3 * render(target, matrix, size, ground=0.0), 1.0))
    assert found is not None
    np.testing.assert_allclose(found.pixels, truth(target, matrix), atol=0.08)


@pytest.mark.whole
def test_a_board_too_small_for_a_picture_of_half_the_size_is_found_in_the_whole() -> None:
    """Squares of 8 px, of which half the size leaves 4."""
    target, size = board(CORNERS), (960, 720)
    camera = Pinhole.from_focal(size, (900.0, 900.0), (480.0, 360.0))
    matrix = plane_homography(camera, pose((5, -10, 3), (0, 0, 1120)))
    found = target.detect(noisy(render(target, matrix, size, blur_px=0.5), 1.0))
    assert found is not None
    assert len(found.ids) == 35
    assert np.abs(found.pixels - truth(target, matrix)).max() < 0.1


@pytest.mark.whole_after(1)
@KINDS
def test_a_board_that_is_not_there_is_not_found(fields: dict) -> None:
    target = board(fields)
    assert target.detect(noisy(np.full(SIZE[::-1], 100.0), 5.0)) is None
    assert target.detect(np.zeros(SIZE[::-1], np.uint8)) is None


def test_a_board_cut_by_the_pictures_edge_is_not_found_in_part() -> None:
    target = board(CORNERS)
    matrix = plane_homography(CAMERA, pose((0, 0, 0), (60, 0, 150)))
    assert target.detect(np.rint(render(target, matrix, SIZE)).astype(np.uint8)) is None


def test_a_colour_picture_is_refused() -> None:
    with pytest.raises(CalibrationError, match="grey image"):
        board(CORNERS).detect(np.zeros((480, 640, 3), np.uint8))


# Circles in perspective

BIG = {"kind": "circles", "size_mm": [80, 62], "counts": [7, 5], "spacing_mm": [11, 11], "diameter_mm": 8}


def discs(target: Target, matrix: np.ndarray, fine: int = 6) -> np.ndarray:
    """A board of circles as it is: each of `fine` x `fine` parts of a pixel inside or outside, then blur."""
    u, v = np.meshgrid(*((np.arange(side * fine) + 0.5) / fine - 0.5 for side in SIZE))
    x = apply_homography(np.linalg.inv(matrix), np.stack([u, v], axis=-1))
    points = target.points()[:, :2]
    nearest = np.rint((x - points[0]) / target.spacing_mm).clip(0, np.array(target.counts) - 1)
    ink = np.linalg.norm(x - points[0] - nearest * target.spacing_mm, axis=-1) < 0.5 * (
        target.diameter_mm or 0
    )
    board = (np.abs(x) < 0.5 * np.array(target.size_mm)).all(axis=-1)
    level = np.where(ink, 30.0, np.where(board, 220.0, 80.0)).astype(np.float32)
    picture = cv2.resize(level, SIZE, interpolation=cv2.INTER_AREA).astype(np.float64)
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.7))


@pytest.mark.nightly
@pytest.mark.parametrize(
    "view", [pose((0, 50, 0), (0, 0, 110)), pose((45, -20, 10), (2, 1, 110)), pose((-55, 0, 0), (0, 0, 100))]
)
def test_ellipses_are_not_taken_for_the_pictures_of_their_circles_centres(view: RigidTransform) -> None:
    target = board(BIG)
    matrix = plane_homography(Pinhole.from_focal(SIZE, (600.0, 600.0), (322.0, 236.0)), view)
    found = target.detect(discs(target, matrix))
    assert found is not None
    assert len(found.ids) == 35
    expected = truth(target, matrix)
    if np.linalg.norm(found.pixels[0] - expected[0]) > 100:  # the board is as good turned by half a turn
        expected = expected[::-1]
    after = np.linalg.norm(found.pixels - expected, axis=1)
    layout = target.layout
    assert isinstance(layout, CircleGrid)
    circles, radius = layout.points()[found.ids, :2], layout.diameter_mm / 2
    offsets = eccentricity(homography(layout, found), circles, radius)
    before = np.linalg.norm(found.pixels + offsets - expected, axis=1)
    assert before.max() > 0.5
    assert np.sqrt(np.mean(after**2)) < 0.005
    assert after.max() < 0.01
    assert np.sqrt(np.mean(before**2)) > 50 * np.sqrt(np.mean(after**2))


# Homographies


@given(st.floats(-35, 35), st.floats(-35, 35), st.floats(-180, 180))
def test_jacobians_are_the_slopes_of_the_homography(a: float, b: float, c: float) -> None:
    target = board(CIRCLES)
    matrix = plane_homography(CAMERA, pose((a, b, c), (3, -4, 200)))
    points = target.points()[:, :2]
    jacobians = homography_jacobians(matrix, points)
    for axis in range(2):
        step = 1e-4 * np.eye(2)[axis]
        slope = (apply_homography(matrix, points + step) - apply_homography(matrix, points - step)) / 2e-4
        np.testing.assert_allclose(jacobians[:, :, axis], slope, atol=1e-6)


def test_homography_is_recovered_from_part_of_the_points() -> None:
    target = board(CIRCLES)
    matrix = plane_homography(CAMERA, VIEWS["steep"])
    ids = np.arange(5, 40, 3)
    found = homography(target, Detection(ids, truth(target, matrix)[ids]))
    np.testing.assert_allclose(found / found[2, 2], matrix / matrix[2, 2], rtol=1e-6, atol=1e-6)


def test_opencv_sees_the_same_markers_in_our_picture() -> None:
    target = board(MARKED)
    picture = cv2.copyMakeBorder(target.image(10.0), 40, 40, 40, 40, cv2.BORDER_CONSTANT, value=255)
    dictionary = charuco_model(target).getDictionary()
    _, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(picture)
    assert sorted(ids.ravel()) == list(range(len(charuco_model(target).getIds())))


# Reference marks


def test_marks_are_found_one_by_one_though_cut_apart() -> None:
    """Two views of the sheet in one image, each with its own half: no homography holds for both."""
    target, size = Target.load("target_marks"), (1000, 700)
    camera = Pinhole.from_focal(size, (1400.0, 1400.0), (499.5, 349.5))
    points, columns = target.points(), target.counts[0]
    held = [pose((9.0 * s, 5.0, 8.0 * s), (0.0, 0.0, 330.0 + 20.0 * s)) for s in (1, -1)]
    views = [plane_homography(camera, one) for one in held]
    of_left = np.arange(len(points)) % columns < columns // 2
    image = render(target, views[0], size)
    image[:, size[0] // 2 :] = render(target, views[1], size)[:, size[0] // 2 :]
    found = target.detect(image)
    assert found is not None
    left, right = (apply_homography(view, points[:, :2]) for view in views)
    off = np.linalg.norm(found.pixels - np.where(of_left[:, None], left, right)[found.ids], axis=1)
    apart = np.abs(found.ids % columns - (columns - 1) / 2) > 1  # the marks in the middle are cut
    assert apart.sum() >= 4 * 25
    assert np.sqrt(np.mean(off[apart] ** 2)) < 0.02


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("counts", (13, 10), "must be even"),
        ("marker_mm", 9.5, "leaves 1.75 mm for circles"),
        ("counts", (22, 10), "'dictionary' has 50 markers and the board 55 marks"),
    ],
)
def test_marks_that_cannot_be_told_apart_are_refused(field: str, value: object, words: str) -> None:
    data = {**config.plain(Target.load("target_marks")), field: value, "size_mm": (400, 300)}
    with pytest.raises(ConfigError, match=words):
        config.validate(data, Target, "marks.yaml")
