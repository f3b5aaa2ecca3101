"""Plans of Gray code guessed from images alone."""

from typing import Any

import numpy as np
import pytest

from fpplab.core.errors import DataError
from fpplab.diagnosis.plan import guess_plan
from tests.phase.test_codes import SIZE, blurred_light, plan_of

WHITE_BLACK = {"kind": "even", "levels": [1, 0]}


def gray(axis: str, bits: int, **more: Any) -> dict[str, Any]:
    return {"kind": "gray", "axis": axis, "bits": bits, **more}


def images_of(sets: list[dict[str, Any]], seed: int, width: float = 234.0) -> list[np.ndarray[Any, Any]]:
    """A chequered plane under the codes, turned by some degrees."""
    random = np.random.default_rng(seed)
    v, u = np.mgrid[:240, :360]
    at = {"x": 3.0 + (width - 2.0) * u / 360 + 0.01 * v, "y": 5.0 + 0.63 * v - 0.008 * u}
    texture = 0.6 + 0.4 * (((u // 23) + (v // 31)) % 2)
    light = []
    for each in sets:
        if axis := each.get("axis"):
            light += list(blurred_light(plan_of([each]), at[axis], axis, 0.6))
        else:
            light += [np.full(u.shape, float(level)) for level in each["levels"]]
    levels = 15 + 190 * texture * np.array(light) + random.normal(0, 2.5, (len(light), *u.shape))
    return list(np.rint(levels).clip(0, 254).astype(np.uint8))


SETS = {
    "white and black first": [WHITE_BLACK, gray("x", 8)],
    "inverses in turn, both axes": [
        gray("x", 8, inverses="each"),
        gray("y", 8, inverses="each"),
        WHITE_BLACK,
    ],
    "inverses after all": [gray("x", 8, inverses="after"), {"kind": "even", "levels": [0, 1]}],
    "finest first": [WHITE_BLACK, gray("x", 8, least_first=True)],
    "wide cells, rows first": [WHITE_BLACK, gray("y", 6, cell_px=3), gray("x", 7, cell_px=2)],
}


@pytest.mark.whole
@pytest.mark.parametrize("name", SETS)
def test_a_code_is_found_from_its_images(name: str) -> None:
    expected = plan_of([{**each, "projector_size": list(SIZE)} for each in SETS[name]])
    found = guess_plan(images_of(SETS[name], 40_100 + list(SETS).index(name)), 8, SIZE)
    assert found.plan.sets == expected.sets
    assert found.disagreement < 2.0
    assert any("cells of" in sentence for sentence in found.assumed)


def test_a_bit_that_is_the_same_all_over_the_scene_counts() -> None:
    frames = images_of([WHITE_BLACK, gray("x", 8)], 40_110, width=118.0)  # the coarsest bit is dark there
    assert guess_plan(frames, 8, SIZE).plan.sets[1].images == 8


def test_images_of_a_code_in_another_order_are_refused() -> None:
    frames = images_of([WHITE_BLACK, gray("x", 8)], 40_111)
    frames[4], frames[7] = frames[7], frames[4]
    with pytest.raises(DataError, match="look like Gray code, but"):
        guess_plan(frames, 8, SIZE)
