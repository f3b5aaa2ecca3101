"""One frame of fringes: its noise and what it leaves out are as stated."""

from dataclasses import replace

import numpy as np
import pytest

from fpplab.acquisition.synchronisation import check_synchronisation
from fpplab.core import config
from fpplab.core.conventions import Floats
from fpplab.core.errors import DataError
from fpplab.diagnosis import Verdict, diagnose_decoded
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import KnownCoordinate, Recording
from fpplab.phase import check_codes, decode
from fpplab.pipeline.decoding import plan_fault

SIZE, STRIPES = (912, 1140), 100.0
PERIOD = SIZE[0] / STRIPES
SET = {"kind": "shifted", "axis": "x", "stripes": STRIPES, "shifts_deg": [40]}
PLAN = config.validate({"fringes": [SET], "unwrapping": "spatial"}, Plan, "plan")
Y, X = np.mgrid[:120, :160].astype(float)
PLANE: Floats = 100.0 + 1.4 * X + 0.1 * Y
INSIDE = (X > 50) & (X < 125) & (Y > 30) & (Y < 90)


def recorded(coordinate: Floats, seed: int = 0, offset: float = 40.0) -> Recording:
    random = np.random.default_rng(seed)
    level = offset + 120.0 * PLAN.sets[0].light(0, coordinate, SIZE[0])
    level += random.normal(0.0, 1.0, level.shape)
    frame = np.rint(np.clip(level, 0, 255) * 4095 / 255).astype(np.uint16)
    return Recording([frame], PLAN, SIZE, bits=12)


def test_noise_is_as_stated_and_the_shape_is_right() -> None:
    truth = PLANE + 3.0 * np.sin(X / 40.0) * np.cos(Y / 30.0)
    maps = [decode(recorded(truth, seed)) for seed in range(8)]
    known = np.all([each.valid for each in maps], axis=0)
    assert known[20:-20, 20:-20].all()
    error = np.array([each.u - truth for each in maps])[:, known]
    error -= PERIOD * np.rint(np.median(error, axis=1, keepdims=True) / PERIOD)
    scatter = np.sqrt(np.mean(np.var(error, axis=0, ddof=1)))
    assert 0.9 < scatter / np.median(maps[0].sigma[known]) < 1.1
    assert np.abs(error).max() < 0.01 * PERIOD


def test_the_carrier_is_found_in_any_direction() -> None:
    truth = 100.0 + 1.0 * X - 1.1 * Y
    decoded = decode(recorded(truth))
    error = (decoded.u - truth)[decoded.valid]
    assert decoded.valid.mean() > 0.7
    assert np.ptp(error) < 0.02 * PERIOD


def test_steps_and_borders_are_not_measured_but_part_islands() -> None:
    decoded = decode(recorded(PLANE + np.where(INSIDE, 1.37 * PERIOD, 0.0)))
    assert decoded.island is not None
    assert len(np.unique(decoded.island)) == 3
    for island in (-2, -1):
        error = (decoded.u - PLANE - np.where(INSIDE, 1.37 * PERIOD, 0.0))[decoded.island == island]
        assert np.ptp(error) < 0.05 * PERIOD
    assert not decoded.valid[:, :3].any()
    assert not decoded.valid[28:92, 49:52].any()


def test_saturated_pixels_have_no_weight() -> None:
    recording = recorded(PLANE)
    frame = recording.frames[0].copy()
    frame[60, 80] = 4095
    decoded = decode(replace(recording, frames=[frame]))
    assert not decoded.valid[60, 80]
    error = (decoded.u - PLANE)[decoded.valid]
    assert np.ptp(error) < 0.02 * PERIOD


def test_a_known_point_and_the_verdict() -> None:
    recording = replace(recorded(PLANE), known=(KnownCoordinate((80, 60), float(PLANE[60, 80])),))
    decoded = decode(recording)
    assert np.abs(decoded.u - PLANE)[decoded.valid].max() < 0.2
    diagnosis = diagnose_decoded(recording, decoded)
    assert diagnosis.verdict is Verdict.UNVERIFIED
    assert "one frame shows nothing narrower than" in diagnosis.reason
    assert any("in which direction the phase rises" in text for text in diagnosis.unknown)


def test_a_plan_of_one_frame_passes_the_checks_before_decoding() -> None:
    check_codes(PLAN, SIZE, "plan")
    recording = recorded(PLANE)
    assert check_synchronisation(recording).in_step
    assert plan_fault(recording) is None


def test_a_frame_without_fringes_is_refused() -> None:
    with pytest.raises(DataError, match="frames: no fringes of at least 4 periods stand out of the frame"):
        decode(recorded(np.full(X.shape, 300.0)))
