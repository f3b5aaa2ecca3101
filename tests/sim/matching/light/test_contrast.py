"""The projector's sharpness, told by the contrast of fine fringes on parts whose reflectance is not known."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import cv2
import numpy as np
import pytest

from fpplab.core.conventions import Floats, Lattice
from fpplab.core.geometry import RigidTransform
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from sim.matching.light.contrast import ContrastSample, board_contrasts, sample_contrasts, with_common_error
from sim.matching.light.light_fit import fit_light, mean_square_difference
from sim.matching.reference import Reference
from sim.matching.samples import TILES, sample_pixels
from sim.matching.scene.artefacts import BenchScan
from sim.matching.steps import (
    FIRST_STEPS,
    PROJECTOR_FOCUS,
    REPEATED_STEPS,
    SHARPNESS_OF_BOARD,
    MatchingContext,
)
from sim.parameters import TwinParameters
from sim.prediction.discrepancy import ContrastDeviation
from tests.sim.matching.test_matching import reference_of
from tests.support.plane_twin import CAMERA, PROJECTOR, SETTINGS, PlaneTwin, Remembered, nominal, tilted

BOARD = Plan(fringes=(Sinusoid(axis="x", stripes=32, steps=4),))
FINE = Plan(fringes=tuple(Sinusoid(axis="x", stripes=n, steps=5) for n in (32, 90, 114)))
ITEM = "pyramid"
POSE = RigidTransform.from_vectors(np.radians([180.0, 6, 0]), np.array([0.0, 0, 455]))
REFERENCE = cast(Reference, SimpleNamespace(full_scale=255))
EVEN = np.ones((CAMERA.size[1], CAMERA.size[0]))


def scanned(bench: TwinParameters, reflectance: Floats = EVEN, plan: Plan = FINE) -> BenchScan:
    """What a bench records of a plane of uneven reflectance, with noise."""
    twin, patterns = PlaneTwin(bench, 3), make_patterns(plan, PROJECTOR.size, Lattice.SQUARE)
    rows, columns = np.indices(reflectance.shape)
    levels = twin.expected_part(ITEM, POSE, patterns, SETTINGS, (rows, columns)).astype(np.float64)
    black = 255 * bench.black_level
    seen = black + reflectance * (levels - black) + np.random.default_rng(4).normal(0, 0.7, levels.shape)
    frames = list(np.rint(seen).clip(0, 255).astype(np.uint8))
    session = Remembered(plan, frames, Path("scan"))
    return BenchScan(ITEM, cast(Any, session), cast(Any, None), POSE, cast(Any, None))


@pytest.fixture(scope="module")
def bench() -> TwinParameters:
    return replace(nominal(tilted(3)), ambient=0.05)


def contrasts(twin: TwinParameters, scan: BenchScan) -> list[ContrastSample]:
    return sample_contrasts(PlaneTwin(twin), [scan], BOARD)


def test_a_twin_that_is_the_bench_leaves_noise_whatever_the_reflectance(bench: TwinParameters) -> None:
    patches = 0.35 + 0.6 * (np.indices(EVEN.shape).sum(axis=0) // 40 % 2)
    (sample,) = contrasts(bench, scanned(bench, patches))
    assert [one.stripes for one in sample.sets] == [90, 114]
    left = sample.residual(REFERENCE, PlaneTwin(bench))
    # Noise, and rounding to whole levels, of one image.
    assert np.sqrt(np.mean(left**2)) == pytest.approx(np.sqrt(0.7**2 + 1 / 12), rel=0.05)
    assert abs(left.mean()) < 4 * left.std() / np.sqrt(len(left))


def of_blur(sigma_px: float, cycles_per_px: Floats) -> Floats:
    """Contrast that the sampled kernel of a Gaussian blur leaves."""
    kernel = cv2.getGaussianKernel(13, sigma_px)[:, 0]
    return np.cos(2 * np.pi * np.outer(cycles_per_px, np.arange(-6, 7))) @ kernel


def test_a_blur_that_differs_shows_by_the_same_share_in_every_brightness(bench: TwinParameters) -> None:
    patches = 0.35 + 0.6 * (np.indices(EVEN.shape).sum(axis=0) // 40 % 2)
    (sample,) = contrasts(bench, scanned(bench, patches))
    off = sample.relative_residual(REFERENCE, PlaneTwin(replace(bench, projector_blur=0.7)))
    cycles = np.array([90, 114]) / PROJECTOR.size[0]
    wanted = 1 - of_blur(0.7, cycles) / of_blur(0.6, cycles)
    by_set = off.reshape(2, -1)
    np.testing.assert_allclose(np.median(by_set, axis=1), wanted, rtol=0.03)
    assert np.ptp(by_set, axis=1).max() < 0.02


def test_blur_and_focus_are_found(bench: TwinParameters) -> None:
    true = replace(bench, projector_blur=0.55, projector_focus_mm=520.0, projector_aperture_mm=9.0)
    patches = 0.35 + 0.6 * (np.indices(EVEN.shape).sum(axis=0) // 40 % 2)
    samples = contrasts(true, scanned(true, patches))
    twin = PlaneTwin(replace(true, projector_blur=0.75))
    found = fit_light(REFERENCE, twin, ("projector_blur",), samples)
    assert found.projector_blur == pytest.approx(0.55, abs=0.01)
    assert abs(found.projector_blur - 0.55) < 4 * found.sigma["projector_blur"]
    assert mean_square_difference(REFERENCE, twin.with_parameters(found), samples) < 0.7


def test_light_of_the_room_on_turned_faces_is_no_blur(bench: TwinParameters) -> None:
    """Which the twin lacks: a lamp that gives the faces of a pyramid up to 8 % more, by Lambert's law."""
    normals = contrasts(bench, scanned(bench))[0].normals
    assert np.ptp(normals, axis=0)[:2].min() > 0.5
    dark = PlaneTwin(bench).expected_of(ITEM, make_patterns(FINE, PROJECTOR.size, Lattice.SQUARE), SETTINGS)
    lamp = 0.15 * (float(dark.mean()) - 255 * bench.black_level)
    scan = scanned(bench)
    (sample,) = sample_contrasts(PlaneTwin(bench), [scan], BOARD)
    turned = lamp * (normals @ np.array([0.8, -0.6, 0.0]))
    lit = replace(sample, offset=sample.offset + turned)
    before = np.abs(sample.relative_residual(REFERENCE, PlaneTwin(bench))).max()
    assert np.abs(lit.relative_residual(REFERENCE, PlaneTwin(bench))).max() < before + 0.005
    whole = replace(sample, offset=sample.offset + 0.05 * lamp / 0.15)
    assert np.median(whole.relative_residual(REFERENCE, PlaneTwin(bench))) < -0.03


def test_a_lamp_of_the_twin_counts_by_its_level_on_the_board_alone(bench: TwinParameters) -> None:
    """Its direction stands for whatever else makes light on a flat board uneven."""
    lit = replace(bench, ambient=0.03, lamp_irradiance=0.04, lamp_angle_deg=60.0)
    (sample,) = contrasts(bench, scanned(bench))
    for azimuth in (0.0, 90.0):
        twin = PlaneTwin(replace(lit, lamp_azimuth_deg=azimuth))
        np.testing.assert_array_equal(
            sample.residual(REFERENCE, twin), sample.residual(REFERENCE, PlaneTwin(bench))
        )


def test_a_contrast_that_is_off_as_a_whole_counts_in_the_uncertainty(bench: TwinParameters) -> None:
    (sample,) = contrasts(bench, scanned(bench))
    uneven = replace(sample, amplitude=sample.amplitude * (1 + 0.02 * np.sin(sample.pixels[0] / 9.0)))
    names = ("projector_blur",)
    found = fit_light(REFERENCE, PlaneTwin(bench), names, [uneven])
    wide = with_common_error(REFERENCE, PlaneTwin(found), names, [uneven])
    by_tile = uneven.relative_residual(REFERENCE, PlaneTwin(found))
    cycles = np.array([90, 114]) / PROJECTOR.size[0]
    per_px = np.mean(np.log(of_blur(0.61, cycles) / of_blur(0.59, cycles)) / 0.02)
    wanted = np.sqrt(np.mean(by_tile**2)) / abs(per_px)
    assert np.hypot(wanted, found.sigma[names[0]]) == pytest.approx(wide.sigma[names[0]], rel=0.15)


def test_fringes_that_the_board_has_as_fine_tell_nothing_new(bench: TwinParameters) -> None:
    coarse = Plan(fringes=(Sinusoid(axis="x", stripes=32, steps=5),))
    assert contrasts(bench, scanned(bench, plan=coarse)) == []


def test_saturated_pixels_are_left_out(bench: TwinParameters) -> None:
    bright = np.where(np.arange(EVEN.shape[1]) > EVEN.shape[1] // 2, 4.0, 0.8) * EVEN
    (sample,) = contrasts(bench, scanned(bench, bright))
    assert 0.2 < np.mean(np.isnan(sample.offset)) < 0.8
    left = sample.residual(REFERENCE, PlaneTwin(bench))
    assert np.isfinite(left).all()
    assert np.abs(left).max() < 6
    assert len(sample.relative_residual(REFERENCE, PlaneTwin(bench))) < 2 * TILES**2
    assert contrasts(bench, scanned(bench, 5 * EVEN)) == []


def test_scans_are_clusters_of_their_own(bench: TwinParameters) -> None:
    scan = scanned(bench)
    first, second = sample_contrasts(PlaneTwin(bench), [scan, scan], BOARD)
    for one, other in zip(first.clusters, second.clusters, strict=True):
        assert not set(one) & set(other)
    assert first.clusters.shape == (3, first.residual(REFERENCE, PlaneTwin(bench)).size)


def test_contrast_of_finer_fringes_is_as_uncertain_as_a_blur_makes_it() -> None:
    known = ContrastDeviation(stripes=64, relative=0.01)
    assert known.sigma(64) == known.sigma(10) == 0.0
    # Of a blur that is off, exp(-k stripes²): four times as many stripes, sixteen times the logarithm.
    assert np.hypot(known.relative, known.sigma(256)) == pytest.approx(0.16)


@pytest.mark.whole
def test_where_scans_tell_the_sharpness_the_board_does_not(bench: TwinParameters) -> None:
    """Light that the twin lacks on the board then leaves the projector's focus alone."""
    true = replace(bench, projector_focus_mm=560.0, projector_aperture_mm=14.0)
    twin, held = PlaneTwin(replace(bench, white=0.9)), reference_of(true, plan=BOARD)
    samples = sample_pixels(held, true, (0, 1, 2), held.finest)
    scans = tuple(contrasts(true, scanned(true)))
    at = MatchingContext(held, twin, samples, "white", scans)
    step = next(one for one in FIRST_STEPS if one.name == "projector defocus")
    before = step.misfit(at)
    found = step.propose(at)
    at = at.with_parameters(found)
    after = step.misfit(at)
    assert before is not None
    assert after is not None
    assert after < 0.1 * before
    dark = mean_square_difference(held, at.twin, samples)
    together, _, fine = REPEATED_STEPS
    assert fine.applies(at)
    tried = together.propose(at)
    at = at.with_parameters(tried)
    assert mean_square_difference(held, at.twin, samples) < 0.2 * dark
    for name in ("projector_blur", *PROJECTOR_FOCUS):
        assert getattr(tried, name) == getattr(found, name)
    alone = replace(at, contrasts=())
    assert step.misfit(alone) is None
    assert not fine.applies(alone)
    assert together.propose(alone).sigma["projector_blur"] != found.sigma["projector_blur"]


@pytest.mark.whole
@pytest.mark.parametrize(("below", "told"), [(0.0, False), (0.9, True)])
def test_a_part_that_blurs_by_itself_is_told_from_the_projector(
    bench: TwinParameters, below: float, told: bool
) -> None:
    """Light that enters the part and leaves it beside: its fringes are less sharp than the board's."""
    held = reference_of(bench, plan=BOARD)
    soft = replace(bench, projector_blur=float(np.hypot(bench.projector_blur, below)))
    twin, poses = PlaneTwin(replace(bench, projector_blur=0.8)), (0, 1, 2)
    scans = tuple(contrasts(soft, scanned(soft)))
    samples = sample_pixels(held, bench, poses, held.finest)
    at = MatchingContext(held, twin, samples, "white", scans)
    at = at.with_parameters(at.fit_projector_sharpness())
    twin = at.twin
    off = board_contrasts(held, twin, poses)
    cycles = np.array([32]) / PROJECTOR.size[0]
    wanted = np.log(of_blur(0.6, cycles) / of_blur(twin.parameters.projector_blur, cycles))
    np.testing.assert_allclose(off, np.broadcast_to(wanted, off.shape), atol=5e-3)
    assert SHARPNESS_OF_BOARD.applies(at) is told
    if told:
        twin = twin.with_parameters(SHARPNESS_OF_BOARD.propose(at))
        assert twin.parameters.projector_blur == pytest.approx(0.6, abs=0.05)
        assert np.median(scans[0].relative_residual(REFERENCE, twin)) < -0.1
