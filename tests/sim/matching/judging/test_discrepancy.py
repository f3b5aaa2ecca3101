"""What is left between bench and twin, where the difference is known."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from fpplab.core import config
from fpplab.devices.rig import Rig
from fpplab.devices.simulation import Predictable
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid
from fpplab.patterns.plan import Plan
from fpplab.pipeline.taking import take_or_resume_session
from sim.bench import VirtualBench
from sim.matching.judging.discrepancy import discrepancy_of, level_differences, scan_figures
from sim.matching.loss import board_mask
from sim.matching.refusal import Refusals
from sim.matching.scene.artefacts import BenchScan, fit_scan
from sim.matching.steps import SAMPLED_POSES
from sim.parameters import TwinParameters
from sim.prediction.discrepancy import Deviation, Discrepancy, LevelDifferences, ScanEffects, named_effects
from tests.sim.matching.test_matching import reference_of
from tests.support.plane_twin import CAMERA, TARGET, PlaneTwin, nominal, tilted

PLAN = Plan(fringes=tuple(Sinusoid(axis="x", stripes=n, steps=4) for n in (1, 8, 32)))
POSES = SAMPLED_POSES + 2
NO_SCANS: tuple[BenchScan, ...] = ()


@pytest.fixture(scope="module")
def truth() -> TwinParameters:
    return nominal(tilted(POSES))


def compared(bench: TwinParameters, twin: TwinParameters) -> Discrepancy:
    return discrepancy_of(reference_of(bench, plan=PLAN), PlaneTwin(twin, 7), NO_SCANS)


@pytest.mark.whole
def test_a_twin_that_is_the_bench_leaves_noise_alone(truth: TwinParameters, tmp_path: Path) -> None:
    found = compared(truth, truth)
    assert found.noise is not None
    assert (found.noise.count, found.noise.fitted) == (2, False)
    assert abs(found.noise.mean) < 0.03
    assert found.distance is None
    assert found.levels is not None
    assert len(found.levels.left_out) == 2
    assert max(found.levels.by_pose.values()) < 0.05
    assert (found.looks_like, found.not_for) == (None, None)
    found.save(tmp_path)
    assert Discrepancy.beside(tmp_path / "rig.yaml") == found


@pytest.mark.whole
def test_noise_that_the_twin_lacks_is_told(truth: TwinParameters) -> None:
    found = compared(replace(truth, full_well_e=truth.full_well_e / 9), truth)
    assert found.noise is not None
    bench = reference_of(truth, plan=PLAN)
    board = board_mask(CAMERA, truth.poses[0], TARGET)
    level = float(bench.frames(0, range(PLAN.images))[:, board].mean()) - 255 * truth.black_level
    shot = 255 * (1 - truth.black_level) / (16 * truth.full_well_e) * level
    wanted = 0.5 * np.log((9 * shot + 1 / 12) / (shot + 1 / 12))  # rounding is the same in both
    assert found.noise.mean == pytest.approx(wanted, rel=0.1)
    assert found.looks_like is not None
    assert "vibration" in found.looks_like
    assert found.not_for == "noise and chance of wrong orders"


@pytest.mark.whole
def test_levels_are_told_by_pose_and_place(truth: TwinParameters) -> None:
    dark = reference_of(replace(truth, vignetting=300.0), plan=PLAN)
    found = level_differences(dark, PlaneTwin(truth))
    assert list(found.by_pose) == [f"pose_{n:02d}" for n in range(POSES)]
    assert len(found.by_pattern) == len(PLAN.fringes)
    place = np.array(found.by_place, float)
    assert place.shape == (5, 5)
    assert place[[0, 0, -1, -1], [0, -1, 0, -1]].mean() > 1.5 * place[2, 2]
    off = truth.poses[3].moved(np.array([0.5, 0.0, 0.0]))
    moved = level_differences(reference_of(truth.with_pose(3, off), plan=PLAN), PlaneTwin(truth)).by_pose
    assert max(moved, key=lambda name: moved[name]) == "pose_03"


def deviation(value: float) -> Deviation:
    return Deviation.of([value], fitted=False)


def test_a_large_discrepancy_says_what_it_looks_like() -> None:
    far = Discrepancy(distance=deviation(0.8))
    looks, not_for = named_effects(far, [0.0], [0.02])
    assert looks is not None
    assert not_for is not None
    assert looks.startswith("interreflection")
    assert not_for.startswith("distances")
    looks, not_for = named_effects(far, [0.0], [0.7])
    assert looks is not None
    assert "reflectance or gloss" in looks
    assert not_for == "parts of this surface"
    assert named_effects(Discrepancy(distance=deviation(0.1)), [0.1], [0.1]) == (None, None)
    uneven = LevelDifferences(by_pose={"a": 0.02, "b": 0.2}, by_pattern={}, by_place=())
    looks, not_for = named_effects(Discrepancy(levels=uneven), [-0.5], [])
    assert looks is not None
    assert "uneven light" in looks
    assert not_for == "noise and chance of wrong orders; levels and saturation"


def test_board_and_scans_count_alike_however_many_there_are() -> None:
    board = [0.02, -0.02, 0.02, -0.02, 0.02, -0.02]
    alone, both = (Deviation.of_kinds([board, scans], fitted=False) for scans in ([], [0.2]))
    assert alone == Deviation.of(board, fitted=False)
    assert alone.spread == pytest.approx(np.std(board, ddof=1))
    assert both.mean == pytest.approx(0.1)
    assert both.spread == pytest.approx(np.hypot(np.std(board, ddof=1), 0.2 / np.sqrt(2)))
    assert both.count == 7
    single = deviation(-0.3)
    assert (single.mean, single.spread) == (-0.3, 0.0)
    # The interval holds what one scan differed by, and not several times that.
    assert 0.3 < 1.96 * single.sigma(0.02) < 0.45


def test_what_scans_show_by_themselves_is_named_with_the_part() -> None:
    still = Discrepancy(distance=deviation(0.05))
    wax = ScanEffects("candle", -0.12, None)
    looks, not_for = named_effects(still, [0.0], [0.0], [wax, ScanEffects("plate", 0.01, None)])
    assert looks is not None
    assert looks.startswith("interreflection, or light below the surface of the candle")
    assert "12 % less contrast" in looks
    assert "plate" not in looks
    assert not_for == "parts of another material than the twin's"
    looks, not_for = named_effects(still, [0.0], [0.0], [ScanEffects("plate", -0.01, -3.94)])
    assert looks == "parts that moved: the plate by -3.9 µm from frame to frame, away from the camera"
    assert not_for == "parts that do not stand still"


@pytest.mark.nightly
def test_scans_of_a_twin_that_is_the_bench_have_its_figures(tmp_path: Path) -> None:
    """And with twice the light on the twin alone its noise is less."""
    found = config.find_config("rig_demo", "rig")
    data = config.parse_yaml(config.read_text(found), found)
    data["bench"] |= {"binning": 8, "subpixels": 2}
    (tmp_path / "rig.yaml").write_text(config.to_yaml(data))
    plan = Plan(fringes=tuple(Sinusoid(axis="x", stripes=n, steps=4) for n in (1, 8, 48)), exposure_s=0.02)
    with Rig.load(tmp_path / "rig.yaml") as rig:
        session = take_or_resume_session(rig, plan, tmp_path / "scan", ("steps", 0))
        assert isinstance(rig.simulation, VirtualBench)
        assert isinstance(rig.simulation, Predictable)
        twin, known = rig.simulation.twin("board"), rig.simulation.image_part_sampler().calibration
        scan = fit_scan(twin, "steps", session, known, Refusals(frozenset()))
        reference = cast(Any, SimpleNamespace(characterisation=SimpleNamespace(calibration=known)))
        real, own = scan_figures(reference, twin, scan)
        assert own.noise_um == pytest.approx(real.noise_um, rel=0.03)
        assert own.distance_um == pytest.approx(real.distance_um, rel=0.05)
        assert own.completeness == pytest.approx(real.completeness, abs=0.01)
        twin = twin.with_parameters(replace(twin.parameters, white=2 * twin.parameters.white))
        _, brighter = scan_figures(reference, twin, scan)
        assert brighter.noise_um < 0.8 * own.noise_um
