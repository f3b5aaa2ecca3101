"""What does not belong is thrown out and named; what people get wrong is said."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from fpplab.characterisation import Characterisation, DistortionModel, Observation, characterise, observe
from fpplab.characterisation.board_diagnosis import find_description_error
from fpplab.characterisation.limits import USUAL_LIMITS
from fpplab.characterisation.observation import explain_board_mismatch
from fpplab.core.errors import CalibrationError
from fpplab.core.geometry import Pinhole, RigidTransform
from fpplab.targets import Target
from tests.support.boards import plane_homography, pose, render
from tests.support.rigs import BOARD, CAMERA, PAIR, SQUARE, observed, poses


def characterised(seen: Sequence[Observation], lights: tuple[int, int] = SQUARE.size) -> Characterisation:
    """Without leaving out each pose in turn to judge the fit, which takes most of the time."""
    return characterise(seen, BOARD, CAMERA.size, lights, level=DistortionModel.K3, validate=False)


# Poses


@pytest.mark.whole
def test_a_pose_in_which_something_moved_is_left_out_and_named() -> None:
    seen = observed(poses(6), noise_px=0.05)
    moved = RigidTransform.from_vectors(np.array([0, 0.05, 0]), np.array([2.0, 0, 0]))
    light = SQUARE.project((moved @ poses(6)[2]).apply(BOARD.points()), PAIR)
    seen[2] = replace(seen[2], projector_px=light)
    found = characterised(seen)
    assert list(found.left_out) == ["pose_2"]
    assert "moved" in found.left_out["pose_2"]
    assert [o.name for o in found.observations] == ["pose_0", "pose_1", "pose_3", "pose_4", "pose_5"]
    assert found.calibration.rms_px["joint"] < 0.08


@pytest.mark.whole
def test_a_board_that_moved_while_it_was_taken_is_named() -> None:
    seen = observed(poses(8), noise_px=0.03)
    still = characterised(seen)
    assert not any("moved" in warning for warning in still.warnings)
    seen[3] = replace(seen[3], projector_px=seen[3].projector_px + (0.1, 0.15))
    moved = characterised(seen)
    assert [w.split(":")[0] for w in moved.warnings if "moved" in w] == [seen[3].name]


def test_too_few_poses_are_refused_naming_each() -> None:
    left_out = {"pose_7": "pose_7: the board was not found", "pose_8": "pose_8: too dark"}
    with pytest.raises(
        CalibrationError, match=r"only 2 of 4 poses .* at least 3 .*pose_7: .*pose_8: too dark"
    ):
        characterise(observed(poses(2)), BOARD, CAMERA.size, SQUARE.size, left_out=left_out)


def test_a_reason_that_poses_share_is_given_once() -> None:
    left_out = {f"pose_{k}": f"pose_{k}: the board was not found" for k in range(7, 10)}
    with pytest.raises(CalibrationError, match=r"\(pose_7 and 2 more: the board was not found\);"):
        characterise(observed(poses(2)), BOARD, CAMERA.size, SQUARE.size, left_out=left_out)


@pytest.mark.whole
def test_left_out_poses_are_reported() -> None:
    left_out = {"pose_9": "pose_9: the board was not found"}
    found = characterise(observed(poses(4)), BOARD, CAMERA.size, SQUARE.size, left_out=left_out)
    assert found.left_out == left_out


def test_poses_without_tilt_are_refused() -> None:
    flat = [pose((0, 0, 0), (x, 0, 250)) for x in (-10, 0, 10, 20)]
    with pytest.raises(CalibrationError, match="tilt"):
        characterise(observed(flat, noise_px=0.05), BOARD, CAMERA.size, SQUARE.size)


@pytest.mark.whole
def test_poses_tilted_too_little_are_refused_with_the_doubt_they_leave() -> None:
    random = np.random.default_rng(0)
    tilts = random.uniform(-2.5, 2.5, (5, 3))
    nearly = [pose(tuple(t), (x, 0, 250)) for t, x in zip(tilts, (-10, 0, 10, 20, 5), strict=True)]  # type: ignore[arg-type]
    with pytest.raises(CalibrationError, match=r"focal length is \d+ ± \d+ px.*tilt"):
        characterise(observed(nearly, noise_px=0.3), BOARD, CAMERA.size, SQUARE.size)


@pytest.mark.whole
def test_parallel_poses_are_refused_as_such() -> None:
    parallel = [pose((25, -10, 5), (x, y, 250)) for x, y in ((-20, 0), (0, 10), (10, -5), (20, 5), (5, 0))]
    with pytest.raises(CalibrationError, match=r"parallel.*tilted by 20° or more"):
        characterise(observed(parallel, noise_px=0.05), BOARD, CAMERA.size, SQUARE.size)


# Points


def spoiled(observations: list[Observation], index: int, device: str, rows: Any, by: Any) -> None:
    pixels = getattr(observations[index], f"{device}_px").copy()
    pixels[rows] += by
    observations[index] = replace(observations[index], **{f"{device}_px": pixels})


@pytest.mark.whole
def test_points_in_a_wrong_place_are_rejected_with_a_reason() -> None:
    clean = observed(poses(8), noise_px=0.05)
    seen = list(clean)
    spoiled(seen, 2, "camera", 7, (3.0, -2.0))
    spoiled(seen, 5, "projector", [20, 30], (0.0, 1.0))
    found = characterise(seen, BOARD, CAMERA.size, SQUARE.size)
    assert {(r.pose, r.point, r.device) for r in found.rejected} == {
        ("pose_2", 7, "camera"), ("pose_5", 20, "projector"), ("pose_5", 30, "projector"),
    }  # fmt: skip
    for rejected in found.rejected:
        true = np.sqrt(13) if rejected.device == "camera" else 1.0
        assert rejected.residual_px == pytest.approx(true, abs=0.2)
        assert f"point {rejected.point} lies {rejected.residual_px:.2f} px" in rejected.why
        assert "others 0.05 px" in rejected.why
    assert found.points == 8 * 52 - 3
    assert found.summary()["rejected"] == 3
    assert "point 7 lies" in found.facts()["Points rejected in pose_2"]
    assert found.calibration.rms_px["joint"] == pytest.approx(0.05 * np.sqrt(2), rel=0.1)
    assert 7 not in found.observations[2].ids
    assert found.leave_one_out_px is not None
    assert found.leave_one_out_px["camera"] < 0.09


@pytest.mark.whole
def test_noise_alone_rejects_nothing() -> None:
    found = characterised(observed(poses(8), noise_px=0.2))
    assert found.rejected == ()
    assert found.points == 8 * 52


@pytest.mark.whole
def test_no_more_than_a_share_of_a_pose_is_rejected_and_the_worst_first() -> None:
    seen = observed(poses(8), noise_px=0.05)
    spoiled(seen, 3, "camera", slice(0, 8), (0.8, 0.0))
    spoiled(seen, 3, "camera", slice(8, 10), (2.0, 0.0))
    found = characterised(seen)
    assert {r.pose for r in found.rejected} == {"pose_3"}
    assert len(found.rejected) == int(USUAL_LIMITS.max_rejected_share * 52)
    assert {8, 9} < {r.point for r in found.rejected}


# Coverage

LIGHTS = (1824, 2300)
"""A projector's image that holds all of the boards."""


def warned(held: list[RigidTransform]) -> str:
    return " | ".join(characterised(observed(held, noise_px=0.01)).warnings)


def spread_poses(tilts: list[tuple[float, float]], depths: tuple[float, ...] = (220, 250, 280)) -> list[Any]:
    places = [(x, y) for y in (-32, 0, 32) for x in (-45, 0, 45)]
    return [
        pose((*tilts[k % len(tilts)], 5 * k), (*(z / 250 * np.array(place)), z))
        for k, place in enumerate(places)
        for z in (depths[k % len(depths)],)
    ]


WELL_TILTED = [(25.0, 5.0), (-25.0, 8.0), (4.0, 28.0), (-3.0, -27.0)]


@pytest.mark.whole
def test_well_spread_poses_cause_no_warning() -> None:
    seen = observed(spread_poses(WELL_TILTED), noise_px=0.01)
    assert characterise(seen, BOARD, CAMERA.size, SQUARE.size).warnings == ()


@pytest.mark.whole
def test_small_tilts_are_warned_of() -> None:
    assert "no board is tilted by more than 10°" in warned(spread_poses([(9, 1), (-9, 2), (2, 9), (0, -10)]))


@pytest.mark.whole
def test_tilts_that_are_alike_are_warned_of() -> None:
    found = warned(spread_poses([(25, 5), (32, 9), (28, -4), (22, 6)]))
    assert "the same tilt" in found
    assert "no board is tilted" not in found


@pytest.mark.whole
def test_distances_that_are_alike_are_warned_of() -> None:
    assert "the same distance, 2" in warned(spread_poses(WELL_TILTED, (249.0, 250.0, 251.0)))


@pytest.mark.whole
def test_bare_parts_of_the_image_are_named() -> None:
    aside = np.array([12.0, 0, 0])
    held = [RigidTransform(T.rotation, T.translation + aside) for T in spread_poses(WELL_TILTED)]
    held = [T for k, T in enumerate(held) if k not in (0, 3, 6)]
    found = characterised(observed(held, noise_px=0.01), LIGHTS)
    assert any("camera's image: upper left, left, lower left" in w for w in found.warnings)
    # The projector's upper left is not seen by the camera at all, so nothing is missed there.
    assert any("projector's image: left, lower left" in w for w in found.warnings)
    assert found.summary()["warnings"] == list(found.warnings)
    assert found.facts()["Warning 1"] == found.warnings[0]


# Mistakes


@pytest.mark.whole_after(2)
@pytest.mark.parametrize(
    ("wrong", "cause"),
    [
        ({"counts": (4, 13)}, r"rows and columns exchanged: 'counts' should be \[13, 4\]"),
        ({"spacing_mm": (9.0, 4.5)}, r"pitches exchanged: 'spacing_mm' should be \[4.5, 9\]"),
        (
            {"counts": (4, 13), "spacing_mm": (9.0, 4.5)},
            r"'counts' should be \[13, 4\] and 'spacing_mm' \[4.5, 9\]",
        ),
        ({"staggered": False}, "half a pitch .*'staggered' should be true"),
    ],
)  # fmt: skip
def test_a_board_described_wrongly_is_named(wrong: dict[str, Any], cause: str) -> None:
    target = BOARD.model_copy(update=wrong)
    with pytest.raises(CalibrationError, match=f"do not form the board described.*{cause}"):
        characterise(observed(poses(6), noise_px=0.05), target, CAMERA.size, SQUARE.size)


@pytest.mark.parametrize("noise_px", [0.05, 3.0])
def test_a_board_described_rightly_is_not_blamed_for_a_poor_fit(noise_px: float) -> None:
    found = observed(poses(6), noise_px=noise_px)
    assert find_description_error(found, BOARD, CAMERA.size, noise_px) is None
    assert find_description_error(found, BOARD, CAMERA.size) is None


EYE = Pinhole.from_focal((640, 480), (1100, 1100), (315, 244))


def picture(target: Target = BOARD) -> np.ndarray:
    return render(target, plane_homography(EYE, pose((25, -15, 10), (1, 2, 190))), EYE.size)


def looked_at(image: np.ndarray, target: Target) -> None:
    blank = np.zeros(image.shape, np.float32)
    observe("pose_1", image, SimpleNamespace(u=blank, v=blank, modulation=blank), target)  # type: ignore[arg-type]


@pytest.mark.whole_after(1)
@pytest.mark.parametrize(
    ("wrong", "cause"),
    [
        ({"counts": (4, 13)}, r"'counts' should be \[13, 4\]"),
        ({"staggered": False}, "'staggered' should be true"),
        (
            {"counts": (4, 13), "spacing_mm": (4.5, 4.5)},
            r"OpenCV's order: 'counts' should be \[13, 4\] and 'spacing_mm' \[4.5, 9\]",
        ),
    ],
)
def test_a_board_not_found_for_its_description_is_named(wrong: dict[str, Any], cause: str) -> None:
    with pytest.raises(CalibrationError, match=f"pose_1: the board was not found .*{cause}"):
        looked_at(picture(), BOARD.model_copy(update=wrong))


def test_a_board_described_as_its_negative_is_named() -> None:
    board = Target(kind="charuco", size_mm=(60, 42), counts=(7, 4), spacing_mm=(6, 6), marker_mm=4.5,
                   dictionary="4x4_50")  # fmt: skip
    negative = board.model_copy(update={"foreground": 0.9, "background": 0.05})
    cause = explain_board_mismatch(picture(board), negative)
    assert cause is not None
    assert "exchanged: 'foreground' should be 0.05 and 'background' 0.9" in cause


def test_charuco_boards_of_other_prints_are_named() -> None:
    board = Target(kind="charuco", size_mm=(60, 48), counts=(7, 5), spacing_mm=(6, 6), marker_mm=4.5,
                   dictionary="4x4_50")  # fmt: skip
    earlier = board.layout.model()
    earlier.setLegacyPattern(True)
    drawn = np.pad(earlier.generateImage((400, 300)), 40, constant_values=255)
    image = cv2.GaussianBlur(drawn, (0, 0), 1.0)
    assert "as OpenCV before 4.6 drew it" in str(explain_board_mismatch(image, board))
    negative = 255 - cv2.GaussianBlur(board.image(8.0), (0, 0), 1.0)
    assert "as its negative" in str(explain_board_mismatch(negative, board))
    assert explain_board_mismatch(np.full((200, 200), 128, np.uint8), board) is None


def test_a_mirrored_charuco_board_is_named() -> None:
    board = Target(kind="charuco", size_mm=(60, 42), counts=(7, 4), spacing_mm=(6, 6), marker_mm=4.5,
                   dictionary="4x4_50")  # fmt: skip
    with pytest.raises(CalibrationError, match="mirror image"):
        looked_at(picture(board)[:, ::-1], board)


def test_a_mirrored_board_is_named() -> None:
    mirrored = observed(poses(6), noise_px=0.05, points=BOARD.points() * (-1, 1, 1))
    with pytest.raises(CalibrationError, match="board is mirrored"):
        characterise(mirrored, BOARD, CAMERA.size, SQUARE.size)


def test_a_mirrored_camera_is_named() -> None:
    """Detection takes a mirrored picture of this board for the board, with its points in mirrored order."""
    x, y = BOARD.points()[:, 0], BOARD.points()[:, 1]
    other = np.array(
        [np.flatnonzero(np.isclose(x, -a) & np.isclose(y, b))[0] for a, b in zip(x, y, strict=True)]
    )
    seen = [
        replace(
            o,
            camera_px=(np.array([CAMERA.size[0] - 1, 0]) + o.camera_px * (-1, 1))[other],
            projector_px=o.projector_px[other],
        )
        for o in observed(poses(6), noise_px=0.05)
    ]
    with pytest.raises(CalibrationError, match="mirrored to each other; switch off mirroring"):
        characterise(seen, BOARD, CAMERA.size, SQUARE.size)
