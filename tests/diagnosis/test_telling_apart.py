"""Causes that look alike, or hide each other, on benches where they were once mistaken."""

import re
from dataclasses import replace

import numpy as np
import pytest

from fpplab.diagnosis import Verdict, diagnose_frames
from fpplab.diagnosis.causes.flicker import FLICKER
from fpplab.diagnosis.causes.projector_focus import PROJECTOR_FOCUS
from fpplab.diagnosis.causes.wrong_resolution import WrongResolutionLimits, moire_spectrum
from fpplab.diagnosis.limits import DiagnosisLimits
from fpplab.diagnosis.sample import FrameSample, SampleLimits
from fpplab.phase import decode
from tests.diagnosis.scenes import Bench as Scene
from tests.diagnosis.test_diagnosis import measured, of_other
from tests.support.faulty_bench import FAULTS, faulty, healthy


@pytest.mark.whole_after(1)
@pytest.mark.parametrize(
    ("cause", "seed"),
    [("camera_focus", 711), ("missing_colour", 718), ("bands", 701), ("wrong_resolution", 720)],
)
def test_it_is_named_first(cause: str, seed: int) -> None:
    """Fine detail that blur has taken away, few stripes in view, few gains, pixels doubled exactly."""
    assert of_other(faulty(cause, seed)).findings[0].cause.key == cause


def test_flicker_leaves_no_trace_of_a_scaled_picture() -> None:
    recording = faulty("flicker", 714).recording()
    spectrum = moire_spectrum(FrameSample.of(recording, decode(recording)), "x")
    assert spectrum is not None
    assert spectrum[1].max() < 0.1 * WrongResolutionLimits().max_moire_px


@pytest.mark.whole
def test_flicker_is_seen_where_the_finest_fringes_are_next_to_lost() -> None:
    blurred = faulty("projector_focus", 731)
    both = FAULTS["flicker"](blurred, np.random.default_rng([731, 9]))
    causes = {one.cause for one in diagnose_frames(both.recording())}
    assert causes >= {PROJECTOR_FOCUS, FLICKER}
    assert FLICKER not in {one.cause for one in diagnose_frames(blurred.recording())}


@pytest.mark.whole
def test_a_scan_with_a_scaled_picture_is_refused() -> None:
    assert of_other(faulty("wrong_resolution", 702)).verdict is Verdict.USELESS
    still = replace(faulty("wrong_resolution", 702), scale=1.0)
    assert of_other(still).verdict is Verdict.GOOD


@pytest.mark.whole
@pytest.mark.parametrize("lit_share", [0.15, 0.6])
def test_no_more_points_are_counted_than_pixels_that_see_the_fringes(lit_share: float) -> None:
    """Dark pixels that became points see the fringes as well, whatever counts as lit."""
    limits = DiagnosisLimits((SampleLimits(min_lit_share=lit_share),))
    _, cloud, diagnosis = measured(Scene(seed=14), limits)
    assert cloud is not None
    points, pixels = (int(word) for word in re.findall(r"\d+", diagnosis.reason))
    assert points == len(cloud)
    assert points <= pixels
    assert diagnosis.criteria[0].name == "points"
    assert diagnosis.criteria[0].value == pytest.approx(points / pixels, rel=1e-3)


@pytest.mark.whole
def test_a_bench_without_fault_shows_neither_bands_nor_a_scaled_picture() -> None:
    recording = healthy(712).recording()
    assert diagnose_frames(recording, decode(recording)) == ()


@pytest.mark.whole
def test_a_bent_response_shows_no_bands() -> None:
    """A row of few phases is brighter or darker by harmonics; a row of all phases is not."""
    assert [one.cause.key for one in of_other(faulty("response", 40)).findings] == ["response"]


@pytest.mark.whole
def test_a_weak_colour_is_told_where_contrast_differs_between_sets() -> None:
    assert of_other(faulty("missing_colour", 1206)).findings[0].cause.key == "missing_colour"


@pytest.mark.whole
def test_without_any_light_the_projector_may_be_dark_or_light_another_place() -> None:
    for cause, seed in (("projector_dark", 1301), ("no_overlap", 1309)):
        found = [one.cause.key for one in of_other(faulty(cause, seed)).findings]
        assert found == ["projector_dark", "no_overlap"]
