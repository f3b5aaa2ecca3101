"""Harmonics, interreflection, scaled pictures, missing colours, bands; the table that lists all causes."""

import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from docs.generate.tables import causes_page
from fpplab.calibration.model import Calibration
from fpplab.core.conventions import Lattice, axis_length
from fpplab.core.geometry import Pinhole
from fpplab.diagnosis import FaultCause, diagnose_frames, known_causes
from fpplab.diagnosis.causes.camera_focus import CAMERA_FOCUS
from fpplab.diagnosis.causes.interreflection import INTERREFLECTION
from fpplab.diagnosis.causes.missing_colour import MISSING_COLOUR, colour_finding
from fpplab.diagnosis.causes.wrong_resolution import WRONG_RESOLUTION
from fpplab.diagnosis.evidence import Evidence
from fpplab.diagnosis.finding import DetectionStage
from fpplab.diagnosis.verdict import find_causes
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from tests.diagnosis.scenes import Bench as Scene
from tests.diagnosis.test_diagnosis import measured, of_other
from tests.support.faulty_bench import faulty


def test_the_table_of_causes_is_the_catalogue() -> None:
    listed = re.findall(r"^\| `(\w+)` \|", causes_page(), re.MULTILINE)
    assert sorted(listed) == sorted(known_causes())


@pytest.mark.whole_after(1)
@pytest.mark.parametrize(
    "cause", ["harmonics", "interreflection", "wrong_resolution", "missing_colour", "bands"]
)
def test_it_is_named_first(cause: str) -> None:
    assert of_other(faulty(cause, 202)).findings[0].cause.key == cause


@pytest.mark.whole
def test_points_that_a_mirroring_face_makes_are_useless() -> None:
    """A third of them stands where there is nothing, and all fringe sets agree on them."""
    found = of_other(faulty("interreflection", 1001))
    assert found.findings[0].cause == INTERREFLECTION
    assert "runs backwards" in found.findings[0].evidence
    assert found.is_useless


@pytest.mark.nightly
@pytest.mark.parametrize(("seed", "ruined"), [(200, True), (202, False)])
def test_blur_makes_points_useless_where_it_costs_far_more_than_noise(seed: int, ruined: bool) -> None:
    (found,) = find_causes(Evidence(faulty("camera_focus", seed).recording()), (DetectionStage.BLUR,))
    assert found.cause == CAMERA_FOCUS
    assert found.ruins_points is ruined


def test_a_colour_is_missing_only_where_every_third_frame_is_dark() -> None:
    places = np.arange(12)
    even = 100.0 + np.random.default_rng(1).normal(0, 3, 12)
    assert colour_finding(even, places) is None
    one_dark = even.copy()
    one_dark[4] = 20
    assert colour_finding(one_dark, places) is None
    found = colour_finding(np.where(places % 3 == 1, 0.5, 1.0) * even, places)
    assert found is not None
    assert found.cause == MISSING_COLOUR
    assert found.evidence.startswith("frames 2, 5, 8")


@pytest.mark.whole
def test_a_lattice_that_is_another_shows_in_the_focal_lengths() -> None:
    scene = Scene(seed=3)
    _, cloud, _ = measured(scene)
    assert cloud is not None
    rig = scene.rig()

    def causes(known: Calibration) -> list[FaultCause]:
        evidence = Evidence(cloud=cloud, calibration=known, intended=scene.plan)
        return [one.cause for one in find_causes(evidence, (DetectionStage.POINTS,))]

    def lattice(projector: Pinhole) -> Calibration:
        return replace(rig, projector=replace(projector, lattice=Lattice.DIAMOND))

    assert causes(rig) == []
    assert causes(lattice(rig.projector)) == [WRONG_RESOLUTION]


def real(captures: Path, name: str) -> Recording:
    plan = Plan.load("plan_slstudio_skull" if "skull" in name else "plan_slstudio_board")
    frames = [cv2.imread(str(captures / name / f"{k:02d}.png"), 0) for k in range(plan.images)]
    return Recording(frames, plan, (1824, 1140))


def named(recording: Recording) -> list[str]:
    return [one.cause.key for one in diagnose_frames(recording, decode(recording))]


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("name", ["skull_2x3", "calseq1", "calseq5"])
def test_real_captures_are_good_as_they_are(captures: Path, name: str) -> None:
    assert named(real(captures, name)) == []


def with_soft_fringes(recording: Recording, sigma_px: float) -> Recording:
    """As a projector out of focus shows them: fringes lose contrast, the finer the more; edges stay sharp."""
    starts, frames = recording.plan.set_starts, []
    for k, fringe in enumerate(recording.plan.fringes):
        own = np.array(recording.frames[starts[k] : starts[k + 1]], np.float64)
        frequency = fringe.stripes / axis_length(recording.projector_size, fringe.axis)
        left = np.exp(-2.0 * (np.pi * sigma_px * frequency) ** 2)
        soft = own.mean(axis=0) + left * (own - own.mean(axis=0))
        frames += list(np.rint(soft).astype(np.uint8))
    return replace(recording, frames=frames)


@pytest.mark.whole
def test_faults_added_to_real_captures_are_named(captures: Path) -> None:
    right = real(captures, "calseq1")
    random = np.random.default_rng(4)
    blurred = [cv2.GaussianBlur(frame, (0, 0), 6.0) for frame in right.frames]
    assert named(replace(right, frames=blurred))[0] == "camera_focus"
    finest = max(f.stripes / axis_length(right.projector_size, f.axis) for f in right.plan.fringes)
    assert named(with_soft_fringes(right, 0.25 / finest))[0] == "projector_focus"
    bright = [np.clip(2.5 * frame.astype(np.float64), 0, 255).astype(np.uint8) for frame in right.frames]
    assert named(replace(right, frames=bright))[0] == "saturated"
    moved = [np.roll(frame, random.integers(-3, 4, 2), (0, 1)) for frame in right.frames]
    assert named(replace(right, frames=moved))[0] == "vibration"
