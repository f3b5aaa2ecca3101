"""What limits the parameters that a step of a matching fits."""

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import cv2
import numpy as np
import pytest

from fpplab.core.conventions import full_scale
from sim.matching.light import light_fit
from sim.matching.loss import board_mask
from sim.matching.reference import Reference
from sim.matching.samples import sample_pixels
from sim.matching.steps import CAMERA_FOCUS, MatchingContext
from sim.parameters import TwinParameters
from tests.sim.matching.test_matching import reference_of, truth
from tests.support.plane_twin import CAMERA, SETTINGS, TARGET, PlaneTwin, Remembered, tilted

__all__ = ["truth"]  # a fixture
pytestmark = pytest.mark.nightly

FULL = full_scale(SETTINGS.bits)


def veiled(parameters: TwinParameters, levels: int) -> Reference:
    """Recordings with light on the board that no parameter tells, of print and ground alike."""
    reference = reference_of(parameters)
    for pose, session in zip(parameters.poses, cast("Sequence[Remembered]", reference.sessions), strict=True):
        board = board_mask(CAMERA, pose, TARGET).astype(np.uint8)
        session.images[:] = [image + levels * board for image in session.images]
    return reference


def fitted_black(reference: Reference, start: TwinParameters) -> tuple[float, float]:
    """The black level that is found, in levels, and the mean square difference that is left."""
    twin = PlaneTwin(start)
    samples = sample_pixels(reference, start, (0, 2), reference.finest)
    at = MatchingContext(reference, twin, samples, "white")
    found = at.fit("white", "ink", "ambient", "black_level")
    at = at.with_parameters(found)
    again = at.fit(*at.light_parameters())
    assert again.black_level == pytest.approx(found.black_level, abs=1e-3)
    known = light_fit.fit_light(
        reference, at.with_parameters(again).twin, ["white", "ink", "ambient"], samples
    )
    assert again.sigma["ink"] > 1.1 * known.sigma["ink"]  # black is not known, though it may be held
    at = at.with_parameters(again)
    return FULL * found.black_level, light_fit.mean_square_difference(reference, at.twin, samples)


def softened(parameters: TwinParameters) -> Reference:
    """Recordings that are blurred by the same everywhere, as by a print or a lens that the twin lacks."""
    reference = reference_of(parameters)
    for session in cast("Sequence[Remembered]", reference.sessions):
        session.images[:] = [cv2.GaussianBlur(image, (0, 0), 0.4) for image in session.images]
    return reference


def test_blur_of_all_poses_is_not_taken_for_a_wider_aperture(truth: TwinParameters) -> None:
    true = replace(truth, poses=tilted(6), camera_focus_mm=455.0, f_number=2.0)
    reference = softened(true)
    samples = sample_pixels(reference, true, range(6), reference.finest)
    at = MatchingContext(reference, PlaneTwin(true), samples, "white")
    found = at.fit("white", *CAMERA_FOCUS)
    assert abs(found.f_number - true.f_number) < 3.0 * found.sigma["f_number"]
    alone = light_fit.fit_light(reference, at.twin, ("white", *CAMERA_FOCUS), samples)
    off = true.f_number - alone.f_number
    assert off > 3.0 * alone.sigma["f_number"]
    assert abs(found.f_number - true.f_number) < 0.5 * off


def test_light_that_no_parameter_tells_is_not_taken_for_black(truth: TwinParameters) -> None:
    reference = veiled(truth, 5)
    black = FULL * truth.black_level
    assert reference.darkest_level == pytest.approx(black, abs=0.5)
    found, _ = fitted_black(reference, replace(truth, black_level=0.0))
    assert found == pytest.approx(reference.darkest_level + 0.5)


def test_black_below_the_darkest_place_is_found_as_before(truth: TwinParameters) -> None:
    held = reference_of(truth)
    found, left = fitted_black(held, replace(truth, black_level=0.0, white=1.0))
    assert found == pytest.approx(FULL * truth.black_level, abs=0.6)
    assert left < 2.0
