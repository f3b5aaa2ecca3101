"""Speeds of parts that moved while they were scanned."""

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import trimesh

from fpplab.core.conventions import Floats, Lattice
from fpplab.core.geometry import RigidTransform
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.fringes import make_patterns
from fpplab.patterns.plan import Plan
from sim.matching.fluctuation.scan_motion import motion_of_scan
from sim.matching.scene.artefacts import BenchScan
from sim.parameters import TwinParameters
from tests.support.plane_twin import CAMERA, PROJECTOR, SETTINGS, PlaneTwin, Remembered, nominal, tilted

PLAN = Plan(fringes=(Sinusoid(axis="x", stripes=50, steps=5), Sinusoid(axis="x", stripes=57, steps=4)))
POSE = RigidTransform.from_vectors(np.radians([8.0, 12, 0]), np.array([0.0, 0, 455]))
EVERY = tuple(np.indices((CAMERA.size[1], CAMERA.size[0])))


class PlateTwin(PlaneTwin):
    """Its parts are a flat plate."""

    def mesh(self, item: str) -> trimesh.Trimesh:
        return trimesh.creation.box((160, 120, 1), RigidTransform(np.eye(3), np.array([0, 0, 0.5])).matrix)


def scanned(
    bench: TwinParameters, moved_mm: Floats, gains: Floats | float = 1.0, plan: Plan = PLAN
) -> BenchScan:
    """A scan of a plate that is displaced along the camera's axis in every frame."""
    twin, patterns = PlateTwin(bench), make_patterns(plan, PROJECTOR.size, Lattice.SQUARE)
    black = 255 * bench.black_level
    frames = []
    random = np.random.default_rng(1)
    for pattern, z, gain in zip(patterns, moved_mm, gains * np.ones(len(patterns)), strict=True):
        level = twin.expected_part("plate", POSE.moved(np.array([0, 0, z])), [pattern], SETTINGS, EVERY)[0]
        seen = black + gain * (level - black) + random.normal(0, 0.6, level.shape)
        frames.append(np.rint(seen).clip(0, 255).astype(np.uint8))
    session = Remembered(plan, frames, Path("scan"))
    return BenchScan("plate", cast(Any, session), cast(Any, None), POSE, cast(Any, None))


@pytest.fixture(scope="module")
def bench() -> TwinParameters:
    return replace(nominal(tilted(1)), projector_focus_mm=None)


@pytest.mark.parametrize("um", [-5.0, 6.0])
def test_a_steady_motion_is_found(bench: TwinParameters, um: float) -> None:
    found = motion_of_scan(PlateTwin(bench), scanned(bench, 1e-3 * um * np.arange(9)))
    assert found is not None
    assert found.um_per_frame == pytest.approx(um, abs=max(4 * found.sigma, 0.3))
    assert found.sigma < 0.8
    assert found.is_significant


def test_a_part_at_rest_has_no_speed_however_the_lamp_flickers(bench: TwinParameters) -> None:
    gains = 1 + 0.01 * np.random.default_rng(2).standard_normal(9)
    found = motion_of_scan(PlateTwin(bench), scanned(bench, np.zeros(9), gains))
    assert found is not None
    assert not found.is_significant
    assert abs(found.um_per_frame) < 4 * found.sigma


@pytest.mark.whole
def test_vibration_makes_speeds_by_chance_as_large_as_stated(bench: TwinParameters) -> None:
    shaking = replace(bench, vibration_line_mm=(0.0, 0.0, 0.008))
    found = []
    for seed in range(12):
        moved = np.random.default_rng([seed, 3]).normal(0, 0.008, 9)
        one = motion_of_scan(PlateTwin(shaking), scanned(bench, moved))
        assert one is not None
        found.append(one.um_per_frame / one.sigma)
    assert 0.5 < np.sqrt(np.mean(np.square(found))) < 1.6


def test_three_images_tell_no_motion(bench: TwinParameters) -> None:
    three = Plan(fringes=(Sinusoid(axis="x", stripes=50, steps=3),))
    assert motion_of_scan(PlateTwin(bench), scanned(bench, np.zeros(3), plan=three)) is None
