"""Images that are turned or mirrored are told from steps that run the other way, where anything tells."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from fpplab.core.conventions import Image
from fpplab.core.depth import DepthRange
from fpplab.diagnosis import Diagnosis, Verdict, diagnose_scan
from fpplab.diagnosis.plan.orientation import check_orientation
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.reconstruction.points import points_of
from tests.diagnosis.scenes import Bench, plan_of

TURNS = {
    "turned by 180": (slice(None, None, -1), slice(None, None, -1)),
    "mirrored, left to right": (slice(None), slice(None, None, -1)),
    "upside down": (slice(None, None, -1), slice(None)),
}
BOTH, ONE = (Bench(plan=plan_of(axes, (4, 4, 6), (1, 8, 48)), seed=83) for axes in ("xy", "x"))


def turned(recording: Recording, how: str) -> Recording:
    return replace(recording, frames=[np.ascontiguousarray(f[TURNS[how]]) for f in recording.frames])


def with_signs(recording: Recording, axes: str) -> Recording:
    sets = [s.model_copy(update={"shift_sign": -1}) if s.axis in axes else s for s in recording.plan.fringes]
    return replace(recording, plan=recording.plan.model_copy(update={"fringes": tuple(sets)}))


def judged(recording: Recording) -> Diagnosis:
    calibration = ONE.rig()
    decoded, cloud = points_of(decode(recording), calibration, recording.plan, recording.mean_image())
    return diagnose_scan(recording, decoded, cloud, calibration)


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("how", TURNS)
def test_both_axes_tell_how_images_stand(how: str) -> None:
    tried = check_orientation(turned(BOTH.recording(), how), BOTH.rig())
    assert tried is not None
    assert [how in rival.meaning for rival, _ in tried.fitting] == [True]
    assert "with that undone points lie 0.0" in tried.evidence


@pytest.mark.whole
@pytest.mark.parametrize("axes", ["x", "y", "xy"])
def test_both_axes_tell_which_steps_run_the_other_way(axes: str) -> None:
    tried = check_orientation(with_signs(BOTH.recording(), axes), BOTH.rig())
    assert tried is not None
    (rival, _), *others = tried.fitting
    assert not others
    assert rival.axes == tuple(axes)
    assert rival.remedy.startswith("change the sign of 'shift_sign' in every set along")


@pytest.mark.whole_after(1)
@pytest.mark.parametrize(
    ("turn", "told"),
    [
        (lambda f: np.rot90(f, -1), "turned by 90° to the right"),
        (np.rot90, "turned by 90° to the left"),
        (np.transpose, "rows and columns of the images are exchanged"),
        (lambda f: f[::-1, ::-1].T, "exchanged, and both run backwards"),
    ],
)
def test_square_images_may_be_turned_by_90_degrees(turn: Callable[[Image], Image], told: str) -> None:
    rig, upright, pixels = BOTH.rig(), BOTH.recording(), slice(80, 400)
    matrix = rig.camera.matrix - [[0, 0, 80], [0, 0, 0], [0, 0, 0]]
    square = replace(rig, camera=replace(rig.camera, size=(320, 320), matrix=matrix))
    frames = [np.ascontiguousarray(turn(f[:, pixels])) for f in upright.frames]
    tried = check_orientation(replace(upright, frames=frames), square)
    assert tried is not None
    assert [rival.meaning.endswith(told) for rival, _ in tried.fitting] == [True]


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("how", ["turned by 180", "mirrored, left to right"])
def test_one_axis_does_not_tell_and_nothing_is_advised(how: str) -> None:
    found = judged(turned(ONE.recording(), how))
    assert found.verdict is Verdict.USELESS
    first = found.findings[0]
    assert first.cause.key == "wrong_orientation"
    for meaning in ("turned by 180°", "mirrored, left to right", "every set along x run the other way"):
        assert meaning in first.evidence
    assert "all of these fit equally" in first.evidence
    assert "shift_sign" not in first.remedy


@pytest.mark.whole
def test_epipolar_lines_tell_steps_that_a_bent_response_hides() -> None:
    recording = replace(BOTH, plan=plan_of("xy", (3, 8, 3), (1, 7, 44)), gamma=1.9, white=0.7).recording()
    sets = [recording.of_set(k) for k in range(len(recording.plan.fringes))]
    early = replace(recording, frames=[f for frames in sets for f in (*frames[1:], frames[0])])
    first = judged(early).findings[0]
    assert first.cause.key == "wrong_plan"
    assert "one step early" in first.evidence
    assert judged(recording).findings[0].cause.key == "response"


@pytest.mark.whole
def test_a_range_of_depths_excludes_what_it_can() -> None:
    recording = replace(turned(ONE.recording(), "turned by 180"), depth=DepthRange((10.0, 20.0), "plan"))
    tried = check_orientation(recording, ONE.rig())
    assert tried is not None
    assert tried.fitting == ()
    assert tried.remedy is None


@pytest.mark.whole
def test_imported_images_are_good_only_for_what_was_checked() -> None:
    found = judged(replace(turned(ONE.recording(), "upside down"), is_imported=True))
    assert found.verdict is Verdict.GOOD
    assert region_of(found).endswith(
        "same region of the sensor as those of the characterisation, and are not upside down"
    )
    both = judged(replace(BOTH.recording(), is_imported=True))
    assert region_of(both).endswith("same region of the sensor as those of the characterisation")
    assert region_of(judged(ONE.recording())) == ""


def region_of(judged: Diagnosis) -> str:
    return next((text for text in judged.unknown if text.startswith("region: ")), "")
