"""Calibrations interpolated between stage positions, turned, and sampled; what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.calibration.model import Calibration, Uncertainty
from fpplab.core.conventions import Lattice
from fpplab.core.errors import CalibrationError, ConfigError
from fpplab.core.geometry import Pinhole, RigidTransform, turned_towards
from fpplab.optimisation.arrangement import RigArranger, StageCalibrations, sample_calibration
from fpplab.optimisation.fringe_cache import MeasuringSetup
from tests.support.rigs import CAMERA, DIAMOND, PAIR
from tests.support.rigs import SQUARE as PROJECTOR

ALONG = np.array([0.8, 0.0, 0.6])


def at(stage_mm: float) -> Calibration:
    """The truth: the projector moved along a straight line, its lens as it is."""
    pose = PAIR.inverse()
    moved = RigidTransform(pose.rotation, pose.translation + stage_mm * ALONG)
    return Calibration(CAMERA, PROJECTOR, moved.inverse(), {})


KNOWN = StageCalibrations({mm: at(mm) for mm in (-20.0, 0.0, 40.0)})


@given(st.floats(-20, 40))
def test_projector_moves_with_the_stage_between_two_known_positions(stage_mm: float) -> None:
    found, true = KNOWN.at(stage_mm).T_projector_camera, at(stage_mm).T_projector_camera
    np.testing.assert_allclose(found.translation, true.translation, atol=1e-9)
    np.testing.assert_allclose(found.rotation, true.rotation, atol=1e-12)


def test_calibration_is_interpolated_linearly_between_positions() -> None:
    """So its parameters stay consistent with one another."""
    turn = RigidTransform.from_vectors(np.array([2e-4, -1e-4, 3e-4]), np.zeros(3))
    longer = replace(PROJECTOR, matrix=PROJECTOR.matrix * np.array([[1.001], [1.001], [1.0]]))
    other = Calibration(CAMERA, longer, turn @ at(40.0).T_projector_camera, {})
    known = StageCalibrations({0.0: at(0.0), 40.0: other})
    quarter = known.at(10.0)
    assert quarter.projector.matrix[0, 0] == pytest.approx(PROJECTOR.matrix[0, 0] * 1.00025, rel=1e-12)
    apart = (quarter.T_projector_camera.rotation @ PAIR.rotation.T).astype(float)
    vector = RigidTransform(apart, np.zeros(3)).rotation_vector
    np.testing.assert_allclose(vector, 0.25 * turn.rotation_vector, rtol=1e-6)


def test_calibration_at_a_known_position_is_returned_unchanged() -> None:
    single = at(0.0)
    assert StageCalibrations({None: single}).at() is single
    assert StageCalibrations({0.0: single}).at(0.0) is single
    assert StageCalibrations({0.0: single, 40.0: at(40.0)}).at(0.0) is single


@given(st.floats(-5, 5))
def test_convergence_rotates_the_projector_about_its_centre(degrees: float) -> None:
    found = KNOWN.at(0.0, degrees)
    np.testing.assert_allclose(found.projector_centre, at(0.0).projector_centre, atol=1e-9)
    assert angle_to_camera(at(0.0)) - angle_to_camera(found) == pytest.approx(degrees, abs=1e-9)


def angle_to_camera(calibration: Calibration) -> float:
    towards = calibration.T_projector_camera.translation
    return float(np.degrees(np.arccos(towards[2] / np.linalg.norm(towards))))


def test_projector_facing_the_camera_cannot_be_turned_towards_it() -> None:
    with pytest.raises(ValueError, match="no direction"):
        turned_towards(RigidTransform(np.eye(3), np.array([0.0, 0.0, 5.0])), 0.1)


@pytest.mark.parametrize(
    ("known", "stage_mm", "message"),
    [
        ({-20.0: at(-20), 40.0: at(40)}, 41.0, "'stage_mm' is 41, .* at -20, 40 mm; characterise it on"),
        ({-20.0: at(-20), 40.0: at(40)}, None, "at -20, 40 mm; 'stage_mm' must give"),
        ({None: at(0)}, 3.0, "at no known position; characterise"),
        ({0.0: at(0)}, 3.0, "at 0 mm; characterise"),
    ],
)  # fmt: skip
def test_stage_position_outside_the_characterised_range_is_refused(
    known: dict[float | None, Calibration], stage_mm: float | None, message: str
) -> None:
    with pytest.raises(CalibrationError, match=message):
        StageCalibrations(known).at(stage_mm)


@pytest.mark.parametrize(
    ("known", "message"),
    [
        ({0.0: at(0), 40.0: at(0)}, r"0 and 40 mm put the projector 0\.0 mm apart, not 40"),
        ({0.0: at(0), 40.0: replace(at(40), projector=DIAMOND)}, "at 40 mm: projector patterns"),
        ({None: at(0), 40.0: at(40)}, "each needs the position of its stage"),
    ],
)
def test_inconsistent_calibrations_are_refused(known: dict[float | None, Calibration], message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        StageCalibrations(known)


def test_sampled_calibrations_have_the_stated_covariance() -> None:
    names = ("camera.fx", "projector.k1", "T_projector_camera.x")
    sigma, shared = np.array([0.5, 1e-3, 0.02]), np.array([[1, 0.8, -0.6], [0.8, 1, -0.3], [-0.6, -0.3, 1]])
    calibration = replace(at(0), uncertainty=Uncertainty(names, shared * np.outer(sigma, sigma)))
    random, draws = np.random.default_rng(0), 2000
    found = [sample_calibration(calibration, random) for _ in range(draws)]
    values = np.array(
        [
            [c.camera.matrix[0, 0], c.projector.distortion[0], c.T_projector_camera.translation[0]]
            for c in found
        ]
    )
    true = CAMERA.matrix[0, 0], PROJECTOR.distortion[0], PAIR.translation[0]
    assert np.abs((values.mean(axis=0) - true) / sigma).max() < 4.0 / np.sqrt(draws)
    np.testing.assert_allclose(np.corrcoef(values.T), shared, atol=4.0 / np.sqrt(draws))
    np.testing.assert_allclose(values.std(axis=0), sigma, rtol=4.0 / np.sqrt(2 * draws))
    assert all(c.camera.matrix[1, 1] == CAMERA.matrix[1, 1] for c in found)


def test_calibrations_without_covariance_are_exact() -> None:
    known = replace(at(0), uncertainty=Uncertainty(("camera.fx",), np.array([[1.0]])))
    assert StageCalibrations({0.0: at(0)}).is_exact
    assert not StageCalibrations({0.0: at(0), 40.0: replace(at(40), uncertainty=known.uncertainty)}).is_exact


class Recorder:
    """A rig that records what it is told to do."""

    def __init__(self, bench: object = None) -> None:
        self.simulation, self.told = bench, []  # type: ignore[var-annotated]
        self.file = type("File", (), {"name": "Recorder"})

    def place_stage(self, mm: float) -> None:
        self.told.append(("stage", mm))

    def need_fixture(self, doing: str) -> Recorder:
        return self

    def mount(self, item: str) -> None:
        self.told.append(("mount", item))

    def turn(self, degrees: float) -> None:
        self.told.append(("turn", degrees))


def test_only_changed_settings_move_the_rig() -> None:
    rig = Recorder()
    rig.simulation = rig
    arrange = RigArranger(rig)  # type: ignore[arg-type]
    for setup in (
        MeasuringSetup("steps", 0.02, 5.0, 0.0),
        MeasuringSetup("steps", 0.01, 5.0, 0.0),
        MeasuringSetup("steps", 0.01, 6.0, 0.0),
        MeasuringSetup("pillars", 0.01, 6.0, 1.0),
    ):
        arrange(setup)
    assert rig.told == [
        ("stage", 5.0), ("turn", 0.0), ("mount", "steps"), ("stage", 6.0), ("turn", 1.0), ("mount", "pillars")
    ]  # fmt: skip


def test_turning_a_real_projector_is_refused() -> None:
    with pytest.raises(ConfigError, match="'convergence_deg' is 2, but only a simulated projector"):
        RigArranger(Recorder())(MeasuringSetup("steps", 0.02, None, 2.0))  # type: ignore[arg-type]


def test_interpolated_calibration_keeps_the_pixel_lattice() -> None:
    diamonds = {mm: replace(at(mm), projector=DIAMOND) for mm in (0.0, 40.0)}
    found: Pinhole = StageCalibrations(diamonds).at(20.0).projector
    assert found.lattice is Lattice.DIAMOND
    assert found.size == DIAMOND.size
