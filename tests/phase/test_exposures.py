"""Frames of several exposures, merged into frames that are decoded as those of one."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fpplab.core import config
from fpplab.core.conventions import Floats, Image
from fpplab.core.errors import DataError
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from fpplab.phase.exposures import exposure_model, merged_recording

SIZE, SHAPE = (240, 160), (80, 120)
EXPOSURES_S = 0.003, 0.03, 0.3
FULL_E, READ_E, BLACK = 10_000.0, 10.0, 5.0
FRINGES: list[dict[str, Any]] = [
    {"axis": "x", "stripes": stripes, "steps": steps} for stripes, steps in ((1, 4), (8, 8))
]
GRAY: list[dict[str, Any]] = [
    {"kind": "even", "levels": [1, 0]},
    {"kind": "gray", "axis": "x", "bits": 8, "inverses": "each"},
]
RUBBER = np.arange(SHAPE[1]) < SHAPE[1] // 2


def plan_of(sets: list[dict[str, Any]]) -> Plan:
    return config.validate({"fringes": sets, "exposures_s": list(EXPOSURES_S)}, Plan, "plan")


def coordinate() -> Floats:
    return np.add.outer(0.03 * np.arange(SHAPE[0]), 20.0 + 1.3 * np.arange(SHAPE[1]))


def frames_at(plan: Plan, exposure_s: float, random: np.random.Generator) -> list[Image]:
    """What an 8-bit camera sees of black rubber, and of polished metal beside it."""
    metal = 2.0 * np.exp(np.sin(np.arange(SHAPE[0]) / 9.0))
    reflectance = np.where(RUBBER, 0.03, metal[:, None])
    frames = []
    for each in plan.sets:
        for step in range(each.images):
            light = 0.05 + 0.85 * each.light(step, coordinate(), SIZE[0])
            mean = FULL_E * reflectance * light * exposure_s / 0.02
            electrons = random.poisson(mean) + READ_E * random.standard_normal(SHAPE)
            levels = BLACK + (255.0 - BLACK) * np.minimum(electrons / FULL_E, 1.0)
            frames.append(np.rint(levels.clip(0.0, 255.0)).astype(np.uint8))
    return frames


def raw_recording(sets: list[dict[str, Any]], seed: int) -> Recording:
    plan, random = plan_of(sets), np.random.default_rng(seed)
    frames = [frame for each in EXPOSURES_S for frame in frames_at(plan, each, random)]
    return Recording(frames, plan, SIZE)


def test_dark_and_bright_parts_are_measured_together_with_an_uncertainty_that_holds() -> None:
    raw = raw_recording(FRINGES, 1)
    shown = raw.plan.images
    for k in range(len(EXPOSURES_S)):
        single = replace(raw, frames=raw.frames[k * shown : (k + 1) * shown])
        assert decode(single).valid.mean() < 0.8
    decoded = decode(merged_recording(raw, EXPOSURES_S))
    assert decoded.valid.mean() > 0.98
    for part in (RUBBER, ~RUBBER):
        errors = ((decoded.u - coordinate()) / decoded.sigma)[:, part]
        assert np.sqrt(np.nanmean(errors**2)) == pytest.approx(1.0, abs=0.06)


def test_samples_of_all_exposures_count() -> None:
    """Metal has less noise than in its shortest exposure alone: its dark samples come from longer ones."""
    raw = raw_recording(FRINGES, 2)
    alone = decode(replace(raw, frames=raw.frames[: raw.plan.images]))
    merged = decode(merged_recording(raw, EXPOSURES_S))
    rms = [np.sqrt(np.nanmean((each.u - coordinate())[:, ~RUBBER] ** 2)) for each in (alone, merged)]
    assert rms[1] < 0.97 * rms[0]


def test_codes_are_merged_too() -> None:
    decoded = decode(merged_recording(raw_recording(GRAY, 3), EXPOSURES_S))
    assert decoded.valid.mean() > 0.95
    assert np.nanmax(np.abs(decoded.u - coordinate())) < 2.0


def test_a_pixel_saturated_in_every_exposure_stays_saturated() -> None:
    raw = raw_recording(FRINGES, 4)
    for frame in raw.frames:
        frame[10:20, 10:20] = 255
    merged = merged_recording(raw, EXPOSURES_S)
    assert (np.array(merged.frames)[:, 10:20, 10:20] == merged.full_scale).all()
    assert not decode(merged).valid[10:20, 10:20].any()
    assert merged.mean_image().dtype == np.uint8


def test_black_ratios_and_noise_follow_from_the_frames() -> None:
    """Also where the camera's true exposures are others than it says."""
    stated = EXPOSURES_S[0], 1.02 * EXPOSURES_S[1], EXPOSURES_S[2]
    model = exposure_model(raw_recording(FRINGES, 5).frames, 8, stated, "frames")
    assert model.black == pytest.approx(BLACK, abs=0.2)
    np.testing.assert_allclose(model.shares, (0.01, 0.1, 1.0), rtol=0.01)
    per_level = (255.0 - BLACK) / FULL_E
    for level in (10.0, 100.0):
        expected = per_level**2 * READ_E**2 + per_level * level + 1 / 12
        assert model.noise.variance(level) == pytest.approx(expected, rel=0.15)


def test_a_camera_whose_levels_are_not_in_proportion_is_refused() -> None:
    raw = raw_recording(FRINGES, 6)
    bent = [np.rint(255.0 * (frame / 255.0) ** 0.45).astype(np.uint8) for frame in raw.frames]
    with pytest.raises(DataError, match="merging needs levels in proportion to light"):
        merged_recording(replace(raw, frames=bent), EXPOSURES_S)
    with pytest.raises(DataError, match="holds 35 frames, but the plan takes 12 at each of 3 exposures"):
        merged_recording(replace(raw, frames=raw.frames[1:]), EXPOSURES_S)


def test_sets_have_exposures_of_their_own() -> None:
    """Coarse fringes have fewer exposures than fine ones: what is stated is by each set's own noise."""
    coarse = {**FRINGES[0], "exposures_s": [0.003, 0.3]}
    short = {**FRINGES[1], "stripes": 3, "exposures_s": [0.03]}
    plan, random = plan_of([coarse, short, FRINGES[1]]), np.random.default_rng(7)
    assert plan.exposures == (0.003, 0.3, 0.03)
    assert [len(images) for images in plan.passes] == [12, 12, 16]
    frames = []
    for exposure_s, images in zip(plan.exposures, plan.passes, strict=True):
        taken = frames_at(plan, exposure_s, random)
        frames += [taken[i] for i in images]
    merged = merged_recording(Recording(frames, plan, SIZE), plan.exposures)
    assert merged.merged is not None
    assert not np.allclose(merged.merged.scales[0], merged.merged.scales[2])
    decoded = decode(merged)
    seen = decoded.valid & (np.abs(decoded.u - coordinate()) < 2.0)
    assert (decoded.valid & ~seen).mean() < 1e-3
    errors = ((decoded.u - coordinate()) / decoded.sigma)[seen]
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(1.0, abs=0.08)
    own = merged.mean_image(0).astype(float)[seen]
    np.testing.assert_allclose(np.median(own / merged.mean_image(2)[seen]), 1.0, atol=0.05)
