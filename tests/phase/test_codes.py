"""Codes of other kinds than fringes, against frames made by their formulas with blur and noise."""

import base64
import zlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from fpplab.acquisition.synchronisation import check_synchronisation
from fpplab.core import config
from fpplab.core.conventions import Axis, Floats
from fpplab.core.errors import ConfigError
from fpplab.diagnosis.plan import code_order_fault
from fpplab.patterns.plan import Plan
from fpplab.patterns.recording import Recording
from fpplab.phase import check_codes, decode
from fpplab.phase.bounds import PossibleCoordinates
from fpplab.phase.code_decoding import _fitted, _fitted_search, decode_codes
from fpplab.phase.code_table import CodeTable, code_table, with_bounds
from fpplab.phase.coded_axes import sets_of_axis
from fpplab.phase.limits import CODES
from fpplab.phase.noise import surprising_power
from fpplab.setup.plan_preview import plan_precision

SIZE = 240, 160
EVEN: dict[str, Any] = {"kind": "even", "levels": [1, 0]}
GRAY: dict[str, Any] = {"kind": "gray", "axis": "x", "bits": 8}
MICRO: list[dict[str, Any]] = [
    {"kind": "shifted", "axis": "x", "stripes": 15, "shifts_deg": [0, 120, 240]}
] + [
    {"kind": "shifted", "axis": "x", "stripes": stripes, "shifts_deg": [0]}
    for stripes in (12.2, 13.1, 14.3, 16.1, 17.3, 18.7)
]
UNEQUAL: list[dict[str, Any]] = [
    {"kind": "shifted", "axis": "x", "stripes": 1, "shifts_deg": [0, 80, 190, 250]},
    {"kind": "shifted", "axis": "x", "stripes": 12, "shifts_deg": [10, 100, 250]},
]
KINDS = {
    "Gray with white and black": [EVEN, GRAY],
    "Gray with inverses": [{**GRAY, "inverses": "each"}],
    "Gray, the finest bit first, inverses after": [{**GRAY, "inverses": "after", "least_first": True}],
    "micro phase shifting": MICRO,
    "modulated phase shifting": [
        {
            "kind": "modulated",
            "axis": "x",
            "stripes": 1,
            "shifts_deg": [0, 120, 240],
            "carrier_stripes": 6,
            "carrier_shifts_deg": [0, 120, 240],
        },
        {"kind": "shifted", "axis": "x", "stripes": 13, "shifts_deg": [0, 120, 240]},
    ],
    "unequal shifts": UNEQUAL,
}


def plan_of(sets: list[dict[str, Any]], **more: Any) -> Plan:
    return config.validate({"fringes": sets, **more}, Plan, "plan")


def blurred_light(plan: Plan, coordinate: Floats, axis: Axis, blur_px: float) -> Floats:
    """What all images of a plan show at coordinates along one axis, (K, ...)."""
    length = SIZE[0] if axis == "x" else SIZE[1]
    fine = np.arange(-8 + 1 / 64, length + 8, 1 / 32)
    images = []
    for each in plan.sets:
        for step in range(each.images):
            if each.coded_axis in (axis, None):
                light = gaussian_filter1d(
                    each.light(step, fine, length), 32 * max(blur_px, 0.03), mode="nearest"
                )
                images.append(np.interp(coordinate, fine, light))
    return np.array(images)


def recorded(
    plan: Plan,
    ratio: float,
    *,
    blur_px: float = 0.7,
    seed: int = 0,
    shape: tuple[int, int] = (60, 200),
    smooth: bool = False,
) -> tuple[Floats, Recording]:
    """Frames along x with a modulation of 60 grey levels, `ratio` times the noise, and their coordinates."""
    random = np.random.default_rng(seed)
    coordinate = random.uniform(6, SIZE[0] - 7, shape)
    if smooth:
        coordinate = np.sort(coordinate, axis=1)
    levels = 30 + 120 * blurred_light(plan, coordinate, "x", blur_px)
    levels += random.normal(0, 60 / ratio, levels.shape)
    frames = np.rint(np.clip(levels, 0, 255) * 4095 / 255).astype(np.uint16)
    return coordinate, Recording(list(frames), plan, SIZE, bits=12)


@pytest.mark.parametrize("sets", KINDS.values(), ids=KINDS)
def test_spread_is_that_of_the_bound_and_stated(sets: list[dict[str, Any]]) -> None:
    """Cramér and Rao's: noise over the part of the slope that offset and modulation do not explain."""
    plan = plan_of(sets)
    check_codes(plan, SIZE, "plan")
    coordinate, recording = recorded(plan, 25)
    decoded = decode(recording)
    light, step = blurred_light(plan, coordinate, "x", 0.7), 0.05
    both = [blurred_light(plan, coordinate + d, "x", 0.7) for d in (step, -step)]
    slope, light = (part - part.mean(axis=0) for part in ((both[0] - both[1]) / (2 * step), light))
    unit = light / np.linalg.norm(light, axis=0)
    slope -= np.sum(slope * unit, axis=0) * unit
    bound = 60 / 25 / (120 * np.linalg.norm(slope, axis=0))
    error = (decoded.u - coordinate)[decoded.valid]
    assert decoded.valid.mean() > 0.98
    assert np.abs(error).max() < 2.0
    assert np.sqrt(np.mean((error / bound[decoded.valid]) ** 2)) < 1.1
    assert 0.9 < np.sqrt(np.mean((error / decoded.sigma[decoded.valid]) ** 2)) < 1.1


Variance = Callable[[float], float]  # of a pixel's levels, from the squares that its code leaves


def exhaustive(table: CodeTable, x: Floats, scores: Floats, at: int, variance_of: Variance) -> list[float]:
    """Coordinate, sigma and gap by the correlations of one pixel's levels with all codes of the grid."""
    step = table.coordinate[1] - table.coordinate[0]
    modulation, slope = scores[at] / table.scale[at], table.slope[at].astype(np.float64)
    square = float(slope @ slope) * modulation**2
    shift = float(slope @ x) * modulation / square if square > 0 else 0.0
    square = square if abs(shift) <= 2 * step else 0.0
    peak = scores[at] ** 2 + shift**2 * square
    variance = variance_of(float(x @ x) - peak)
    # Valleys are those of the candidates.
    middle = scores[table.middle]
    top = int(table.owner[at])
    for way in (-1, 1):
        while 0 <= top + way < len(middle) and middle[top + way] > middle[top]:
            top += way
    ends = [top, top]
    for k, way in enumerate((-1, 1)):
        while 0 <= ends[k] + way < len(middle) and middle[ends[k] + way] <= middle[ends[k]]:
            ends[k] += way
    lobe = np.zeros(len(scores), bool)
    lobe[table.start[ends[0]] : table.start[ends[1] + 1]] = True
    runner_up = max(0.0, float(np.max(scores[~lobe], initial=0.0)))
    lost = peak - scores**2
    near = lobe & (scores > 0) & (lost <= CODES.hull_chi2 * variance)
    near[at] = True
    weight = np.exp(-0.5 * lost[near] / variance)
    mean = float(np.average(table.coordinate[near], weights=weight))
    spread = float(np.average((table.coordinate[near] - mean) ** 2, weights=weight)) + step**2 / 12
    if square > 0 and variance / square < step**2 and spread < 4 * step**2:
        mean, spread = table.coordinate[at] + shift, variance / square
    return [mean, np.sqrt(spread), min((peak - runner_up**2) / variance, CODES.certain_chi2)]


def random_stripes(images: int, *, back: bool = False) -> list[dict[str, Any]]:
    """Files of random stripes of three columns, or of nine of which the middle differs a bit."""
    random, column = np.random.default_rng(3), np.arange(SIZE[0])
    levels = random.integers(20, 235, (images, SIZE[0]))[:, column // 9]
    levels += 20 * (column // 3 % 3 == 1) * random.choice((-1, 1), (images, SIZE[0]))[:, column // 9]
    if not back:
        levels = (random.integers(0, 2, (images, SIZE[0])) * 255)[:, column // 3]
    packed = [base64.b64encode(zlib.compress(each.astype(np.uint8).tobytes())).decode() for each in levels]
    names = [f"{k}.png" for k in range(images)]
    return [{"kind": "files", "axis": "x", "names": names, "levels": packed}]


@pytest.mark.whole
@pytest.mark.parametrize("ratio", [5, 10, 20, 50])
@pytest.mark.parametrize(
    "name", ["Gray with white and black", "Gray with inverses", "micro phase shifting", "random stripes"]
)
@pytest.mark.parametrize("smooth", [False, True], ids=["rough", "smooth"])
@pytest.mark.parametrize("bounded", [False, True], ids=["unguided", "guided"])
def test_the_search_finds_what_all_codes_of_the_grid_give(
    name: str, ratio: float, smooth: bool, bounded: bool
) -> None:
    """Also of smooth images, in which each pixel begins at the coordinate of the one before."""
    plan = plan_of(KINDS.get(name) or random_stripes(12))
    coordinate, recording = recorded(plan, ratio, seed=int(ratio), shape=(10, 40), smooth=smooth)
    sets, reach = sets_of_axis(plan, "x", with_fringes=True), 20.0 if bounded else 1000.0
    ends = [np.clip(coordinate + d, -0.5, SIZE[0] - 0.5).astype(np.float32) for d in (-reach, reach)]
    coded = decode_codes(recording, "x", sets, PossibleCoordinates(*ends) if bounded else None)
    table = code_table(tuple(plan.sets), "x", SIZE, recording.lattice, coded.blur_px)
    unit = table.unit[:, : len(table.coordinate)].astype(np.float64)
    levels = np.stack([frame.reshape(-1) for frame in recording.frames], axis=1) * recording.grey
    freedom = max(levels.shape[1] - 3, 1)
    surprise = surprising_power(freedom) * freedom
    step = table.coordinate[1] - table.coordinate[0]
    for n, (own, lower, upper) in enumerate(zip(levels, *(end.ravel() for end in ends), strict=True)):
        expected = float(coded.noise.variance(own.mean()))
        variance = lambda left, e=expected: left / freedom if left > surprise * e else e  # noqa: E731
        x = own - own.mean()
        possible = (table.coordinate > lower - step) & (table.coordinate < upper + step)
        scores = np.where(possible, x @ unit, -1.0)
        figures = [values.ravel()[n] for values in (coded.coordinate, coded.sigma, coded.gap)]
        ties = np.flatnonzero(scores >= scores.max() * (1.0 - 1e-6))
        assert any(
            figures == pytest.approx(exhaustive(table, x, scores, int(at), variance), rel=2e-3, abs=2e-3)
            for at in ties
        ), n


@pytest.mark.parametrize("ratio", [10, 40])
@pytest.mark.parametrize("back", [False, True])
def test_candidates_that_are_left_out_change_nothing(*, back: bool, ratio: float) -> None:
    """Also of codes that go and come back, where another peak lies beside the best one."""
    plan = plan_of(random_stripes(12, back=back))
    _, recording = recorded(plan, ratio)
    frames = [frame.reshape(-1) for frame in recording.frames]
    search, _ = _fitted_search(recording, "x", sets_of_axis(plan, "x", with_fringes=True), frames)
    every, few = (
        replace(search, table=table).run(frames, slice(0, frames[0].size))
        for table in (search.table, with_bounds(search.table))
    )
    np.testing.assert_allclose(few, every, rtol=1e-5, atol=1e-5)


def test_blur_and_noise_are_fitted_once() -> None:
    _, recording = recorded(plan_of(KINDS["micro phase shifting"]), 25)
    decode(recording)
    before = _fitted.cache_info()
    assert code_order_fault(recording) is None
    after = _fitted.cache_info()
    assert (after.misses, after.hits) == (before.misses, before.hits + 1)


def test_wide_cells_state_their_width() -> None:
    plan = plan_of([EVEN, {**GRAY, "bits": 5, "cell_px": 8}])
    coordinate, recording = recorded(plan, 25)
    decoded = decode(recording)
    error = (decoded.u - coordinate)[decoded.valid]
    assert 0.9 < np.sqrt(np.mean((error / decoded.sigma[decoded.valid]) ** 2)) < 1.1
    assert 4 / np.sqrt(12) < np.median(decoded.sigma[decoded.valid]) < 8 / np.sqrt(12)


def test_the_chance_of_another_coordinate_is_as_stated() -> None:
    """By frames of so few periods that noise often takes one coordinate for another."""
    plan = plan_of(MICRO[:5])
    coordinate, recording = recorded(plan, 8, shape=(100, 200))
    coded = decode_codes(recording, "x", sets_of_axis(plan, "x", with_fringes=True))
    wrong = float(np.mean(np.abs(coded.coordinate - coordinate) > 3))
    stated = float(np.mean(1.0 / (1.0 + np.exp(0.5 * np.minimum(coded.gap, 200.0)))))
    assert wrong > 0.01
    assert 0.5 < stated / wrong < 2.0


@pytest.mark.parametrize("sets", KINDS.values(), ids=KINDS)
def test_what_noise_makes_of_codes_is_known_before(sets: list[dict[str, Any]]) -> None:
    plan = plan_of(sets)
    coordinate, recording = recorded(plan, 8, seed=9)
    planned = plan_precision(plan, SIZE, 1 / 8)
    coded = decode_codes(recording, "x", sets_of_axis(plan, "x", with_fringes=True))
    error = coded.coordinate - coordinate
    wrong = np.abs(error) > CODES.apart_px
    assert planned.sigma_px["x"] == pytest.approx(np.sqrt(np.mean(error[~wrong] ** 2)), rel=0.1)
    assert planned.wrong_orders["x"] == pytest.approx(wrong.mean(), rel=1.0, abs=3e-4)


def test_uncertainty_of_fringes_whose_orders_codes_tell_is_that_of_the_fringes() -> None:
    fringes = {"axis": "x", "stripes": 15, "steps": 4}
    both = plan_precision(plan_of([{**GRAY, "bits": 4, "cell_px": 16}, EVEN, fringes]), SIZE, 0.02)
    assert both.sigma_px == plan_precision(plan_of([fringes]), SIZE, 0.02).sigma_px


@pytest.mark.parametrize("blur_px", [0.0, 1.0, 2.0])
def test_orders_of_fringes_by_gray_cells_of_a_period(blur_px: float) -> None:
    """Also at the edges of periods, where blur leaves a bit at any level, and noise of the phase no doubt."""
    sinusoid = {"axis": "x", "stripes": 15, "steps": 4}
    plan = plan_of([{**GRAY, "bits": 4, "cell_px": 16}, EVEN, sinusoid])
    coordinate, recording = recorded(plan, 30, blur_px=blur_px)
    decoded = decode(recording)
    assert decoded.valid.mean() > (0.97 if blur_px else 0.95)
    assert np.abs(decoded.u - coordinate)[decoded.valid].max() < 1.0


def test_gray_codes_give_the_orders_of_two_sets_that_repeat() -> None:
    fringes = [{"axis": "x", "stripes": stripes, "steps": 3} for stripes in (18.0, 27.0)]
    plan = plan_of([*fringes, {**GRAY, "bits": 4, "cell_px": 20, "inverses": "each"}])
    coordinate, recording = recorded(plan, 30, blur_px=1.2)
    decoded = decode(recording)
    assert decoded.valid.mean() > 0.97
    assert np.abs(decoded.u - coordinate)[decoded.valid].max() < 1.5


def test_a_late_frame_of_a_code_with_inverses_is_seen() -> None:
    _, recording = recorded(plan_of([{**GRAY, "inverses": "each"}]), 30)
    assert check_synchronisation(recording).in_step
    late = [recording.frames[-1], *recording.frames[:-1]]
    assert not check_synchronisation(replace(recording, frames=late)).in_step


def test_saturated_and_faint_pixels_are_not_measured() -> None:
    _, recording = recorded(plan_of([EVEN, GRAY]), 30)
    frames = [frame.copy() for frame in recording.frames]
    frames[0][:10] = 4095
    for frame in frames:
        frame[20:30] = 300 + frame[20:30] // 64
    decoded = decode(replace(recording, frames=frames))
    assert not decoded.valid[:10].any()
    assert not decoded.valid[20:30].any()
    assert decoded.valid[40:].mean() > 0.98


def test_codes_that_look_alike_are_refused() -> None:
    plan = plan_of([{"kind": "shifted", "axis": "x", "stripes": 15, "shifts_deg": [0, 120, 240]}])
    with pytest.raises(
        ConfigError, match=r"plan: 'fringes' along x look alike at coordinates \d+ and \d+ px"
    ):
        check_codes(plan, SIZE, "plan")
    few = plan_of([{"kind": "shifted", "axis": "x", "stripes": 1, "shifts_deg": [0, 120]}])
    with pytest.raises(ConfigError, match=r"have 2 images that tell the coordinate along x.*at least 3"):
        check_codes(few, SIZE, "plan")


def test_fringes_of_a_plan_with_codes_are_not_taken_for_all_of_it() -> None:
    plan = plan_of([GRAY, {"axis": "x", "stripes": 15, "steps": 4}])
    assert plan.fringe_part is not None
    assert [each.stripes for each in plan.fringe_part.fringes] == [15]
    with pytest.raises(ConfigError, match=r"has sets that are no fringes \(gray\)"):
        _ = plan.fringes
