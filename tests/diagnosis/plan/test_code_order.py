"""Images of codes in another order than the plan's are named; codes alone are never called good."""

from dataclasses import replace

import numpy as np
import pytest

from fpplab.diagnosis.plan.code_order import code_order_fault
from fpplab.diagnosis.verdict import Verdict, diagnose_decoded
from fpplab.patterns.recording import Recording
from fpplab.phase import decode
from tests.phase.test_codes import EVEN, GRAY, SIZE, blurred_light, plan_of


def smooth(*sets: dict[str, object]) -> Recording:
    """A tilted plane under the codes, with noise."""
    plan, random = plan_of(list(sets)), np.random.default_rng(4)
    coordinate = np.linspace(8, SIZE[0] - 9, 330) + np.linspace(0, 4, 20)[:, None]
    levels = 20 + 180 * blurred_light(plan, coordinate, "x", 0.6)
    frames = np.rint(levels + random.normal(0, 2, levels.shape)).clip(0, 254).astype(np.uint8)
    return Recording(list(frames), plan, SIZE)


def exchanged(recording: Recording, first: int, second: int) -> Recording:
    frames = list(recording.frames)
    frames[first], frames[second] = frames[second], frames[first]
    return replace(recording, frames=frames)


SETS = {
    "alone": (EVEN, GRAY),
    "with inverses": ({**GRAY, "inverses": "each"},),
    "with fringes": (EVEN, {**GRAY, "bits": 5, "cell_px": 8}, {"axis": "x", "stripes": 15, "steps": 4}),
}


@pytest.mark.parametrize("sets", SETS.values(), ids=SETS)
def test_the_order_of_images_is_found_out(sets: tuple[dict[str, object], ...]) -> None:
    recording = smooth(*sets)
    assert code_order_fault(recording) is None
    for first, second in ((0, 1), (2, 3), (3, 6)):
        fault = code_order_fault(exchanged(recording, first, second))
        assert fault is not None, (first, second)
        assert f"images {first} and {second} (from 0) are exchanged" in fault


def test_a_gray_code_that_begins_with_the_finest_bit_is_found_out() -> None:
    recording = smooth(EVEN, GRAY)
    turned = replace(recording, frames=[*recording.frames[:2], *recording.frames[:1:-1]])
    assert "write 'least_first: true'" in str(code_order_fault(turned))
    own = plan_of([EVEN, {**GRAY, "least_first": True}])
    assert code_order_fault(replace(turned, plan=own)) is None


def test_codes_alone_are_at_best_unverified() -> None:
    recording = smooth(EVEN, GRAY)
    judged = diagnose_decoded(recording, decode(recording))
    assert judged.verdict is Verdict.UNVERIFIED
    assert "not verified: codes: only fringes show flicker" in judged.reason
    assert {criterion.name for criterion in judged.criteria} == {"points", "misfit"}
    wrong = exchanged(recording, 4, 7)
    assert diagnose_decoded(wrong, decode(wrong)).verdict is not Verdict.GOOD
