"""What changes images between scene and decoder is named, and told by what it costs."""

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np
import pytest

from benchmarks.image_faults import OTHERS, SIGMA_JUDGED, KnownScene, drawn_scene
from fpplab.core.conventions import Image
from fpplab.diagnosis import Finding
from fpplab.diagnosis.verdict import diagnose_scan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.reconstruction.points import triangulate


@cache
def known_scene() -> KnownScene:
    return drawn_scene(11)


def findings(frames: Sequence[Image]) -> tuple[Finding, ...]:
    recording = Recording(frames, known_scene().plan, (912, 1140))
    decoded = decode(recording)
    cloud = triangulate(decoded, known_scene().calibration)
    return diagnose_scan(recording, decoded, cloud, known_scene().calibration).findings


@pytest.mark.whole
@pytest.mark.parametrize(
    ("fault", "cause", "cost"),
    [
        ("droplet", "lens_smear", "µm off there"),
        ("interchanged_rows", "row_order", "µm off"),
        ("exchanged_halves", "row_order", "columns are moved around"),
        ("lag", "frame_lag", "µm, which σ contains"),
        ("jpeg_15", "processed_images", "µm, which σ contains"),
    ],
)
def test_it_is_named_first_with_its_cost(fault: str, cause: str, cost: str) -> None:
    damage = {**SIGMA_JUDGED, **OTHERS}[fault]
    first = findings(damage(known_scene().frames, np.random.default_rng([44, 11])))[0]
    assert first.cause.key == cause
    assert cost in first.evidence


@pytest.mark.whole
@pytest.mark.parametrize("fault", ["healthy", "row_noise"])
def test_they_are_not_seen_where_they_are_not(fault: str) -> None:
    damage = {**SIGMA_JUDGED, **OTHERS}[fault]
    named = {
        found.cause.key for found in findings(damage(known_scene().frames, np.random.default_rng([44, 11])))
    }
    assert not named & {"lens_smear", "row_order", "frame_lag", "processed_images"}


@pytest.mark.whole
def test_light_within_a_hollow_is_no_smear() -> None:
    """As an eye socket of a skull: fine fringes lose half of their contrast, wider ones a part of it too."""
    v, u = np.indices(known_scene().frames[0].shape)
    hollow = 0.5 * np.exp(-((((u - 250) ** 2 + (v - 190) ** 2) / 60.0**2) ** 2))
    lit = [
        frame + hollow * (cv2.GaussianBlur(frame, (0, 0), 30.0) - 1.0 * frame)
        for frame in known_scene().frames
    ]
    named = {found.cause.key for found in findings([np.rint(frame).astype(np.uint8) for frame in lit])}
    assert "lens_smear" not in named
