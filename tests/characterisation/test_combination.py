"""Combining calibrations of one rig, against what the rig was like each time."""

from dataclasses import replace

import numpy as np
import pytest

from fpplab.calibration.changes import parameter_vector
from fpplab.calibration.displacements import error_modes
from fpplab.calibration.model import PARAMETERS, Calibration, CalibrationOrigin
from fpplab.characterisation import DistortionModel, characterise
from fpplab.characterisation.combination import combine
from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.core.geometry import RigidTransform
from fpplab.core.origin import DeviceIdentity
from tests.characterisation.test_correction import TRUE, seen_by
from tests.support.rigs import BOARD, CAMERA, SQUARE
from tests.support.uncertain_calibrations import mean_chi_square

NAMES = "abcd"


@pytest.fixture(scope="module")
def stated() -> Calibration:
    return characterise(
        seen_by(TRUE, 6, 3), BOARD, CAMERA.size, SQUARE.size, level=DistortionModel.K3
    ).calibration


def drawn(stated: Calibration, seed: int, moved_mm: float = 0.0, factor: float = 1.0) -> list[Calibration]:
    """Calibrations with errors as stated times a factor, of the true rig with its projector moved."""
    uncertainty = stated.uncertainty
    assert uncertainty is not None
    # The board's scale, which is the same in all of them, is left as it is.
    errors, random, made = error_modes(uncertainty), np.random.default_rng(seed), []
    for _ in NAMES:
        values = dict(zip(PARAMETERS, parameter_vector(TRUE), strict=True))
        for name, off in zip(
            uncertainty.names, factor * errors @ random.normal(size=errors.shape[1]), strict=True
        ):
            values[name] += off
        numbers = np.array(list(values.values()))
        lenses = [
            type(CAMERA).from_focal(old.size, tuple(n[:2]), tuple(n[2:4]), tuple(n[4:9]))
            for old, n in ((CAMERA, numbers[:12]), (SQUARE, numbers[12:24]))
        ]
        pair = RigidTransform.from_vectors(numbers[24:27], numbers[27:] + random.normal(0, moved_mm, 3))
        made.append(replace(stated, camera=lenses[0], projector=lenses[1], T_projector_camera=pair))
    return made


@pytest.mark.whole
def test_the_mean_of_calibrations_that_vary_as_stated_is_better_than_each(stated: Calibration) -> None:
    known = stated.uncertainty
    assert known is not None
    found = [combine(drawn(stated, seed), NAMES) for seed in range(3)]
    assert 0.6 < np.mean([mean_chi_square(one.calibration, TRUE) for one in found]) < 1.4
    assert not any(one.varying for one in found)
    sigma = found[0].quantities["camera.fx"]
    assert sigma.stated == pytest.approx(known.sigma["camera.fx"], rel=1e-6)
    assert sigma.combined == pytest.approx(sigma.stated / 2, rel=0.2)
    assert np.mean([one.factor for one in found]) < 1.3


@pytest.mark.whole
def test_a_rig_that_varies_is_as_uncertain_as_it_varies(stated: Calibration) -> None:
    found = [combine(drawn(stated, seed, moved_mm=1.0), NAMES) for seed in range(10, 13)]
    assert (
        0.5
        < np.mean([mean_chi_square(one.calibration, drawn(stated, 9, 1.0, 0.0)[0]) for one in found])
        < 1.5
    )
    for one in found:
        assert "baseline" in one.varying
        assert one.probabilities["projector or camera moved"] > 0.99
        assert one.quantities["baseline"].combined > one.quantities["baseline"].between > 0.3


@pytest.mark.whole
def test_errors_greater_than_stated_are_seen(stated: Calibration) -> None:
    found = [combine(drawn(stated, seed, factor=4.0), NAMES) for seed in range(20, 22)]
    assert 3.0 < np.mean([one.factor for one in found]) < 5.0
    assert 0.5 < np.mean([mean_chi_square(one.calibration, TRUE) for one in found]) < 1.5


def test_calibrations_of_different_rigs_are_refused(stated: Calibration) -> None:
    one, two = drawn(stated, 30)[:2]
    other = replace(two, camera=replace(two.camera, size=(1201, 900)))
    with pytest.raises(
        CalibrationError, match=r"the camera of b is 1201 x 900 px.* combine calibrations of one rig"
    ):
        combine([one, other], NAMES[:2])
    made = [CalibrationOrigin.now(projector=DeviceIdentity(model="P", serial=s)) for s in "12"]
    with pytest.raises(
        CalibrationError, match="the projector of b is P, serial 2, but that of a is P, serial 1"
    ):
        combine([replace(c, origin=o) for c, o in zip((one, two), made, strict=True)], NAMES[:2])
    far = replace(
        two,
        T_projector_camera=RigidTransform(
            two.T_projector_camera.rotation, 2 * two.T_projector_camera.translation
        ),
    )
    with pytest.raises(
        CalibrationError, match=r"a and b: differ by more than turns by 0\.3°, shifts by 3 mm"
    ):
        combine([one, far], NAMES[:2])
    with pytest.raises(ConfigError, match="b: is the calibration a again"):
        combine([one, one], NAMES[:2])
    with pytest.raises(ConfigError, match="two calibrations or more"):
        combine([one], NAMES[:1])
