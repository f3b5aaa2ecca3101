"""What changes from frame to frame on a bench, as a matching finds it where there is some."""

from dataclasses import replace

import numpy as np
import pytest

from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from sim.effects.vibration import Vibration
from sim.matching.fluctuation.bands import LIMITS, Bands, ripple_in_step
from sim.matching.fluctuation.frame_series import RowProfile, fit_fluctuation
from sim.matching.fluctuation.frame_terms import GAIN, FrameTerms
from sim.matching.fluctuation.fringe_residuals import Variances, fringe_residuals, residual_of_set
from sim.matching.samples import sample_pixels
from sim.matching.steps import FIRST_STEPS, MatchingContext
from sim.parameters import TwinParameters
from tests.sim.matching.test_matching import reference_of, truth
from tests.support.plane_twin import PlaneTwin

__all__ = ["truth"]  # a fixture

PLAN = Plan(fringes=tuple(Sinusoid(axis=axis, stripes=24, steps=8) for axis in ("x", "y")))
SHAKEN_MM = 0.01
PROFILE = RowProfile(np.arange(4.0), np.ones(4))


def context(bench: TwinParameters, start: TwinParameters) -> MatchingContext:
    reference, twin = reference_of(bench, plan=PLAN), PlaneTwin(start)
    return MatchingContext(reference, twin, sample_pixels(reference, start, [0], [0]), "white")


def proposed(name: str, bench: TwinParameters, start: TwinParameters) -> TwinParameters:
    """What a step proposes; the twin is left as it was."""
    at = context(bench, start)
    found = next(one for one in FIRST_STEPS if one.name == name).propose(at)
    assert at.twin.parameters is start
    return found


@pytest.mark.nightly
@pytest.mark.parametrize("flicker", [0.002, 0.01])
def test_flicker_of_a_shaking_bench_is_found(truth: TwinParameters, flicker: float) -> None:
    bench = replace(truth, projector_flicker=flicker, vibration_mm=SHAKEN_MM)
    found = proposed("flicker", bench, truth)
    told = fit_fluctuation(
        [one.series(GAIN) for one in context(bench, truth).frame_terms()], oscillates=False
    )
    assert told.gained > 20
    assert found.projector_flicker == pytest.approx(flicker, rel=0.25)
    assert abs(found.projector_flicker - flicker) < 3 * found.sigma["projector_flicker"]
    assert found.sigma["projector_flicker"] < 0.2 * flicker


@pytest.mark.nightly
def test_steady_light_of_a_shaking_bench_has_no_flicker(truth: TwinParameters) -> None:
    found = proposed("flicker", replace(truth, vibration_mm=SHAKEN_MM), truth)
    assert found.projector_flicker < 3e-4


@pytest.mark.parametrize(("ripple", "is_found"), [(0.01, False), (0.3, True)])
def test_faults_of_a_fit_are_no_ripple_of_a_faint_room(ripple: float, is_found: bool) -> None:
    """A hundredth of light that is a hundredth of the level is a ten-thousandth of the level."""
    random, frames, tiny = np.random.default_rng(3), np.arange(16.0), 1e-10 * np.eye(96).reshape(16, 6, 16, 6)
    poses = []
    for pose in range(6):
        values = np.zeros((16, 6))
        values[:, 1] = ripple / np.sqrt(2) * random.standard_normal(16)
        poses.append(FrameTerms(pose, frames, np.repeat([0, 1], 8), values, tiny, 0.01, PROFILE))
    found = ripple_in_step(poses)
    assert (found.gained > 0) == is_found
    assert found.amplitude == (pytest.approx(ripple, rel=0.2) if is_found else 0.0)


@pytest.mark.nightly
def test_rolling_bands_are_found(truth: TwinParameters) -> None:
    lit = replace(truth, ambient=0.05)
    bench = replace(lit, ambient_ripple=0.3, band_period_px=37.0, vibration_mm=SHAKEN_MM)
    found = proposed("rolling bands", bench, lit)
    at = context(bench, lit)
    told = Bands.of(fringe_residuals(at.reference, lit, range(len(lit.poses))))
    assert told is not None
    assert told.rolling(0.1).gained > 20
    assert found.ambient_ripple == pytest.approx(0.3, rel=0.3)
    assert abs(found.ambient_ripple - 0.3) < 3 * found.sigma["ambient_ripple"]
    assert found.band_period_px == pytest.approx(37.0, rel=0.05)
    assert abs(found.band_period_px - 37.0) < 4 * found.sigma["band_period_px"]
    assert found.band_advance is None, "their place is another in each frame"


@pytest.mark.nightly
def test_bands_that_move_on_evenly_are_found(truth: TwinParameters) -> None:
    lit = replace(truth, ambient=0.05)
    bench = replace(lit, ambient_ripple=0.3, band_period_px=37.0, band_advance=0.31)
    found = proposed("rolling bands", bench, lit)
    assert found.band_period_px == pytest.approx(37.0, rel=0.05)
    assert found.band_advance == pytest.approx(0.31, abs=0.01)
    assert found.ambient_ripple == pytest.approx(0.3, rel=0.2)


@pytest.mark.nightly
@pytest.mark.parametrize("advance", [0.1, 0.125])
def test_light_in_step_is_found_where_no_fit_of_phase_steps_sees_it(
    truth: TwinParameters, advance: float
) -> None:
    """An eighth of a period for each of eight phase steps: it shifts the phase, and leaves nothing."""
    lit = replace(truth, ambient=0.05)
    bench = replace(lit, ambient_ripple=0.2, band_period_px=LIMITS.in_step_period_px, band_advance=advance)
    found = proposed("rolling bands", bench, lit)
    assert found.band_period_px == LIMITS.in_step_period_px
    assert found.band_advance == pytest.approx(advance, abs=5e-3)
    assert found.ambient_ripple == pytest.approx(0.2, rel=0.1)
    assert abs(found.ambient_ripple - 0.2) < 4 * found.sigma["ambient_ripple"]


@pytest.mark.parametrize(
    "advance", [pytest.param(0.1, marks=pytest.mark.nightly), pytest.param(-0.125, marks=pytest.mark.whole)]
)
def test_bands_wider_than_the_board_are_found(truth: TwinParameters, advance: float) -> None:
    lit = replace(truth, ambient=0.05)
    bench = replace(lit, ambient_ripple=0.2, band_period_px=300.0, band_advance=advance)
    found = proposed("rolling bands", bench, lit)
    assert found.band_period_px == pytest.approx(300.0, rel=0.1)
    assert abs(found.band_period_px - 300.0) < 4 * found.sigma["band_period_px"]
    assert found.band_advance == pytest.approx(advance, abs=5e-3)
    assert found.ambient_ripple == pytest.approx(0.2, rel=0.1)
    assert abs(found.ambient_ripple - 0.2) < 4 * found.sigma["ambient_ripple"]


@pytest.mark.parametrize(
    "source",
    [pytest.param("even", marks=pytest.mark.nightly), pytest.param("lamps", marks=pytest.mark.whole)],
)
def test_which_light_of_the_room_ripples_is_found(truth: TwinParameters, source: str) -> None:
    lit = replace(truth, ambient=0.03, lamp_irradiance=0.05, lamp_angle_deg=60.0)
    bench = replace(
        lit,
        ambient_ripple=0.15,
        even_light_rippling=float(source == "even"),
        lamp_light_rippling=float(source == "lamps"),
        band_period_px=LIMITS.in_step_period_px,
        band_advance=0.1,
    )
    found = proposed("rolling bands", bench, lit)
    assert (found.even_light_rippling, found.lamp_light_rippling) == (source == "even", source == "lamps")
    assert found.ambient_ripple == pytest.approx(0.15, rel=0.1)


@pytest.mark.nightly
def test_steady_light_of_a_shaking_bench_has_no_bands(truth: TwinParameters) -> None:
    bench = replace(truth, vibration_mm=SHAKEN_MM, projector_flicker=0.005)
    found = proposed("rolling bands", bench, truth)
    assert found.ambient_ripple == 0.0


@pytest.mark.nightly
def test_vibration_along_a_line_is_found_with_its_frequency(truth: TwinParameters) -> None:
    line = (0.012, -0.004, 0.006)
    bench = replace(
        truth,
        vibration_line_mm=line,
        vibration_periodic=0.8,
        vibration_cycles_per_frame=0.21,
        vibration_mm=0.0,
    )
    at = context(bench, truth)
    found = Vibration().propose(at)
    size = np.linalg.norm(found.vibration_line_mm)
    assert size == pytest.approx(np.linalg.norm(line), rel=0.3)
    assert abs(np.dot(found.vibration_line_mm, line)) / size / np.linalg.norm(line) > 0.95
    assert found.vibration_cycles_per_frame == pytest.approx(0.21, abs=0.01)
    assert found.vibration_periodic == pytest.approx(0.8, abs=0.2)
    assert found.vibration_mm < 0.3 * size


def test_motion_of_fringes_leaves_no_waves() -> None:
    """Every frame is shifted by a hundredth of a radian, and by a gain of a thousandth."""
    random, fringe = np.random.default_rng(3), Sinusoid(axis="x", stripes=24, steps=12)
    phase, pixels = random.uniform(0, 2 * np.pi, 5000), random.integers(0, 300, (2, 5000))
    shifted = phase - fringe.phase_shifts()[:, None] + random.normal(0, 0.01, (12, 1))
    gains = random.normal(0, 0.001, (12, 1))
    slopes = random.normal(0, 5, (2, 5000))
    moved = random.normal(0, 0.01, (12, 2)) @ slopes / 100
    levels = (1 + gains + moved) * (100 + 80 * np.cos(shifted)) + random.normal(0, 1, shifted.shape)
    places = (pixels[0], pixels[1])
    bands = Bands.of([residual_of_set(levels, slopes, places, fringe)])
    assert bands is not None
    assert bands.rolling(0.1).gained < 0
    waves = 0.4 * np.cos(2 * np.pi * (pixels[0] / 23.0 + 0.3 * np.arange(12)[:, None]))
    bands = Bands.of([residual_of_set(levels + waves, slopes, places, fringe)])
    assert bands is not None
    found = bands.rolling(0.1)
    assert found.gained > 10
    assert found.period_px == pytest.approx(23.0, rel=0.02)
    assert found.advance == pytest.approx(0.3, abs=0.01)
    assert found.amplitude == pytest.approx(0.04, rel=0.2)


def test_a_further_variance_is_found_beside_noise() -> None:
    random, count = np.random.default_rng(2), 400
    noise = np.full(count, 2.0)
    values = random.normal(0, np.sqrt(2.0 + 3.0), count)
    told = Variances(values**2, noise, np.ones(count))
    assert told.further == pytest.approx(3.0, rel=0.2)
    assert told.criterion(told.further, 1) < told.criterion(0.0, 0) - 20
    alone = Variances(random.normal(0, np.sqrt(2.0), count) ** 2, noise, np.ones(count))
    assert alone.criterion(alone.further, 1) > alone.criterion(0.0, 0)


@pytest.mark.whole
def test_faults_of_the_fringes_are_no_changes_of_frames(truth: TwinParameters) -> None:
    """The twin's fringes are distorted and its image is darker towards the edge; the bench only vibrates."""
    calibration = truth.calibration
    bent = replace(calibration.projector, distortion=np.array([0.05, 0.5]))
    calibration = replace(calibration, projector=bent)
    start = replace(truth, calibration=calibration, vignetting=truth.vignetting + 1.0)
    at = context(replace(truth, vibration_mm=1e-3), start)
    gain, moves = at.fluctuation("projector", oscillates=False), at.fluctuation("position")
    assert gain.random.isotropic < 3e-4
    assert 0.5e-3 < moves.size / np.sqrt(3) < 2e-3
    assert not moves.oscillation.any()
