"""Each finding has its picture, in the report of a scan and in the folder of a check."""

import io

import numpy as np
import pytest
from PIL import Image as Pixels

from fpplab.diagnosis import Finding, known_causes
from fpplab.diagnosis.causes.of_rig_check import SLOW_DISK, SLOW_LINK
from fpplab.diagnosis.causes.saturated import SATURATED
from fpplab.diagnosis.evidence import Evidence
from fpplab.phase import decode
from fpplab.reconstruction.points import points_of
from fpplab.report.evidence import evidence_pictures, evidence_report
from fpplab.setup.rig_check.marker import marker
from tests.support.faulty_bench import PLANS, healthy


@pytest.fixture(scope="module")
def given() -> Evidence:
    bench = healthy(7)
    assert bench.plan is PLANS["both"]
    recording = bench.recording()
    decoded, cloud = points_of(decode(recording), bench.calibration, bench.plan, recording.mean_image())
    shown = marker()
    return Evidence(
        recording, decoded, cloud, bench.calibration, shown, {"stepped": np.roll(shown, 1) / 255.0}
    )


def test_every_cause_is_drawn_or_has_its_place_elsewhere() -> None:
    for cause in known_causes().values():
        assert (cause.picture is None) == bool(cause.shown_by), cause


@pytest.mark.whole
def test_each_picture_has_something_on_it(given: Evidence) -> None:
    causes = [cause for cause in known_causes().values() if cause.picture is not None]
    drawn = evidence_pictures([Finding(cause, "1.2 of 1", 1.2) for cause in causes], given)
    assert [one.cause for one, _ in drawn] == causes
    for one, picture in drawn:
        with Pixels.open(io.BytesIO(picture)) as image:
            assert np.asarray(image.convert("L")).std() > 5.0, one.cause


def test_what_was_not_taken_is_not_drawn() -> None:
    findings = [Finding(cause, "", 1.0) for cause in known_causes().values()]
    drawn = [one.cause for one, _ in evidence_pictures(findings, Evidence())]
    assert drawn == [SLOW_DISK, SLOW_LINK]


def test_the_caption_tells_value_and_limit(given: Evidence) -> None:
    words = "33 % of the lit pixels are saturated (at most 5 %)"
    (figure,) = evidence_report([Finding(SATURATED, words, 6.6)], given)
    assert figure.caption == f"Saturated: {words}."
