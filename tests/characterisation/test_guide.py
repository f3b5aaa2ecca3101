"""The guide: first poses, what does not fit, and words for a person."""

from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest

from fpplab.characterisation import Observation
from fpplab.characterisation.candidate_poses import tilted_away
from fpplab.characterisation.first_poses import RoughView
from fpplab.characterisation.guide import Guide, describe_pose, outline_px
from fpplab.core.geometry import RigidTransform
from tests.support.plane_twin import CAMERA, PAIR, PROJECTOR, TARGET

SIZES = (CAMERA.size, PROJECTOR.size)
FIRST = RigidTransform(tilted_away((0, -1), 28.0), np.array([4.0, -3.0, 450.0]))


def seen(pose: RigidTransform, name: str, seed: int = 0, noise_px: float = 0.03) -> Observation:
    random = np.random.default_rng([3, seed, len(name), *name.encode()])
    places = pose.apply(TARGET.points())
    ids = np.flatnonzero(CAMERA.sees(places) & PROJECTOR.sees(places, PAIR))
    pixels = [
        exact + random.normal(0, noise_px, exact.shape)
        for exact in (CAMERA.project(places[ids]), PROJECTOR.project(places[ids], PAIR))
    ]
    return Observation(name, ids, pixels[0], pixels[1])


def moved(observation: Observation) -> Observation:
    """The board slid by a third of a millimetre before the fringes along y."""
    off = 0.5 + 0.3 * np.linspace(-1, 1, len(observation.ids))
    return replace(observation, projector_px=observation.projector_px + np.stack([0 * off, off], axis=1))


def guided(count: int, bad: tuple[int, ...] = (), seed: int = 0) -> Guide:
    """A guide with poses as it asked for them; the bad ones moved, and nobody noticed."""
    guide = Guide(TARGET, SIZES, depth_mm=(425.0, 475.0))
    for k in range(count):
        pose = guide.next_pose().T_camera_target or FIRST
        observation = seen(pose, f"pose_{k}", seed)
        guide.add(moved(observation) if k in bad else observation)
    return guide


def test_the_first_poses_are_seen_whole_without_any_calibration() -> None:
    guide = Guide(TARGET, SIZES)
    assert guide.next_pose().T_camera_target is None
    assert "upper edge tilted away" in guide.next_pose().description
    for k, pose in enumerate((FIRST, None, None)):
        at = pose or guide.next_pose().T_camera_target
        assert at is not None
        found = seen(at, f"pose_{k}")
        assert len(found.ids) == 52
        guide.add(found)
    assert guide.estimate is not None
    assert guide.depth_mm == pytest.approx((0.945 * 450, 1.055 * 450), rel=0.03)


@pytest.mark.parametrize("tilt", [18.0, 25.0, 35.0])
def test_one_tilted_view_tells_the_focal_length_about(tilt: float) -> None:
    pose = RigidTransform(tilted_away((0, -1), tilt), np.array([4.0, -3.0, 450.0]))
    view = RoughView.of([seen(pose, "pose_0", noise_px=0.01)], TARGET, SIZES)
    assert view.camera.matrix[0, 0] == pytest.approx(1216, rel=0.15)
    corners = np.array([[0, 0], np.array(SIZES[0]) - 1])  # centres of the outermost pixels
    np.testing.assert_allclose(view.camera.matrix[:2, 2], corners.mean(axis=0))
    known = RoughView.of([seen(pose, "pose_0")], TARGET, SIZES, pose)
    assert known.camera.matrix[0, 0] == pytest.approx(1216, rel=0.03)


@pytest.fixture(scope="module")
def five() -> Guide:
    """Five good poses; tests change copies."""
    return guided(5)


@pytest.mark.whole
def test_a_moved_board_is_far_from_what_is_predicted_and_a_good_one_is_not(five: Guide) -> None:
    guide = deepcopy(five)
    pose = guide.next_pose().T_camera_target
    assert pose is not None
    good, bad = (guide.judged(o) for o in (seen(pose, "good"), moved(seen(pose, "bad"))))
    assert good is not None
    assert bad is not None
    assert good.contradicting_devices == ()
    assert "projector" in bad.contradicting_devices
    assert bad.outlying_pose is None
    assert good.camera.rms_px == pytest.approx(good.camera.predicted_px, rel=0.35)


@pytest.mark.nightly
def test_good_poses_are_hardly_ever_far() -> None:
    """From the fourth pose on, in 18 of them."""
    far = []
    for seed in range(10, 13):
        guide = guided(3, seed=seed)
        for k in range(3, 9):
            pose = guide.next_pose().T_camera_target
            assert pose is not None
            observation = seen(pose, f"pose_{k}", seed)
            fit = guide.judged(observation)
            assert fit is not None
            far += fit.contradicting_devices
            guide.add(observation)
    assert not far


@pytest.mark.nightly
def test_an_early_pose_that_was_bad_is_found_by_later_ones() -> None:
    guide = guided(4, bad=(1,))
    if "pose_1" not in [o.name for o in guide.observations]:
        return  # the first fit has found it
    for k in range(4, 8):
        pose = guide.next_pose().T_camera_target
        assert pose is not None
        observation = seen(pose, f"pose_{k}")
        fit = guide.judged(observation)
        assert fit is not None
        if fit.outlying_pose is not None:
            assert fit.outlying_pose == "pose_1"
            guide.drop(fit.outlying_pose)
            break
        guide.add(observation)
    assert "pose_1" not in [o.name for o in guide.observations]


@pytest.mark.whole
def test_a_pose_that_was_given_up_is_not_asked_for_again(five: Guide) -> None:
    guide = deepcopy(five)
    first = guide.next_pose()
    assert first.T_camera_target is not None
    guide.exclude(first)
    second = guide.next_pose().T_camera_target
    assert second is not None
    apart = np.linalg.norm(second.translation - first.T_camera_target.translation)
    turned = (second @ first.T_camera_target.inverse()).rotation_vector
    assert apart > 15.0 or np.degrees(np.linalg.norm(turned)) > 12.0


@pytest.mark.whole
def test_parts_of_the_image_without_points_are_filled(five: Guide) -> None:
    guide = deepcopy(five)
    for k in range(5, 12):
        if not guide.has_uncovered_region:
            break
        before = guide.next_pose(fill=True)
        assert before.T_camera_target is not None
        guide.add(seen(before.T_camera_target, f"pose_{k}"))
    assert not guide.has_uncovered_region


@pytest.mark.parametrize(
    ("pose", "words"),
    [
        (
            RigidTransform(tilted_away((0, -1), 25), np.array([-45.0, -35.0, 410.0])),
            "in the upper left of the image, 40 mm nearer than the first pose (410 mm), "
            "upper edge tilted away by 25 degrees",
        ),
        (
            RigidTransform(tilted_away((1, 1), 30), np.array([0.0, 0.0, 450.0])),
            "in the middle of the image, as far as the first pose (450 mm from the camera), "
            "lower right corner tilted away by 30 degrees",
        ),
        (
            RigidTransform.from_vectors(np.array([0, 0, np.pi / 2]), np.array([60.0, 0.0, 480.0])),
            "in the right of the image, 30 mm farther than the first pose (480 mm), facing the camera, "
            "turned by 90 degrees clockwise",
        ),
    ],
)
def test_a_pose_in_words(pose: RigidTransform, words: str) -> None:
    assert describe_pose(pose, CAMERA, 450.0) == words


def test_the_outline_is_where_the_camera_sees_the_board() -> None:
    pose = RigidTransform(np.eye(3), np.array([0.0, 0.0, 450.0]))
    outline = outline_px(pose, CAMERA, (60.0, 42.0))
    assert outline.shape == (40, 2)
    np.testing.assert_allclose(
        outline[[0, 20]], CAMERA.project(np.array([[-30, -21, 450.0], [30, 21, 450.0]]))
    )
    assert np.ptp(outline[:10, 1]) < 1.0
