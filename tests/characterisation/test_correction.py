"""Correcting a calibration by few poses, against what really changed."""

from dataclasses import replace

import numpy as np
import pytest

from fpplab.calibration.changes import changed_rigs
from fpplab.calibration.model import Calibration
from fpplab.characterisation import Characterisation, DistortionModel, Observation, characterise, judge
from fpplab.characterisation.correction import correct
from fpplab.core.errors import CalibrationError
from tests.characterisation.test_judging import BENT, NOISE_PX, of_nine_poses
from tests.support.rigs import BOARD, CAMERA, PAIR, SQUARE, poses
from tests.support.uncertain_calibrations import mean_chi_square

TRUE = Calibration(CAMERA, SQUARE, PAIR, {})


@pytest.fixture
def found() -> Characterisation:
    return of_nine_poses()


def seen_by(rig: Calibration, count: int, seed: int) -> list[Observation]:
    random, taken = np.random.default_rng(seed), []
    for k, pose in enumerate(poses(count, seed=seed)):
        places = pose.apply(BENT)
        camera, light = rig.camera.project(places), rig.projector.project(places, rig.T_projector_camera)
        noise = random.normal(0, NOISE_PX, (2, *camera.shape))
        taken.append(Observation(f"pose_{k}", np.arange(len(BENT)), camera + noise[0], light + noise[1]))
    return taken


def left_out_px(calibration: Calibration, fresh: list[Observation]) -> float:
    judged = judge(calibration, fresh)
    return float(np.hypot(judged.camera.rms_px, judged.projector.rms_px))


@pytest.mark.whole
@pytest.mark.parametrize(("count", "allowed"), [(1, 1.5), (2, 1.3)])
def test_a_change_is_corrected_nearly_as_by_a_new_characterisation(
    found: Characterisation, count: int, allowed: float
) -> None:
    name = "the projector turned by 0.1° about its y axis"
    now = changed_rigs(TRUE)[name]
    refit = characterise(seen_by(now, 9, 40), BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.K3)
    corrected, fresh = correct(found.calibration, seen_by(now, count, seed=20)), seen_by(now, 8, 41)
    best = left_out_px(refit.calibration, fresh)
    assert (
        left_out_px(corrected.calibration, fresh)
        < allowed * best
        < 0.2 * left_out_px(found.calibration, fresh)
    )
    assert corrected.before.contradicted
    assert not corrected.after.contradicted


@pytest.mark.whole
def test_what_changed_is_told_where_the_poses_tell(found: Characterisation) -> None:
    zoomed = changed_rigs(TRUE)["the lens of the projector zoomed by 0.4 %"]
    corrected = correct(found.calibration, seen_by(zoomed, 3, seed=21))
    chances = corrected.probabilities
    assert chances["projector's lens or picture changed"] > 0.99
    assert max(chances["projector or camera moved"], chances["camera's lens or picture changed"]) < 0.05
    assert corrected.untold == ()


@pytest.mark.whole
def test_uncertainties_hold(found: Characterisation) -> None:
    """Errors of the parameters in standard deviations of the independent modes of the stated covariance."""
    off = []
    for k, now in enumerate(list(changed_rigs(TRUE).values())[::3]):
        calibration = correct(found.calibration, seen_by(now, 1 + k % 2, seed=30 + k)).calibration
        off.append(mean_chi_square(calibration, now))
    assert np.mean(off) < 1.5


def test_nothing_is_worse_where_nothing_changed(found: Characterisation) -> None:
    corrected, fresh = correct(found.calibration, seen_by(TRUE, 3, seed=22)), seen_by(TRUE, 8, 42)
    assert not corrected.before.contradicted
    assert left_out_px(corrected.calibration, fresh) < 1.02 * left_out_px(found.calibration, fresh)


def test_what_no_change_explains_is_refused(found: Characterisation) -> None:
    bent = [
        replace(o, camera_px=o.camera_px + 3e-6 * (o.camera_px - 600.0) ** 2) for o in seen_by(TRUE, 2, 23)
    ]
    with pytest.raises(CalibrationError, match="no change of place, lenses or pictures explains"):
        correct(found.calibration, bent)
