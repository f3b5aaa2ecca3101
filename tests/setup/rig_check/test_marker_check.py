"""The marker of uniform grey-level images reveals every slip, for any response and ambient light."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fpplab.acquisition.synchronisation import Cause, SyncFault, considered_faults
from fpplab.core.conventions import Floats
from fpplab.setup.rig_check.marker import marker
from fpplab.setup.rig_check.marker_check import matching_faults

SHOWN = marker()
GREYS = len(SHOWN)
ALL = [fault for fault in considered_faults(GREYS) if fault.cause is not Cause.SWAPPED]


def levels(fault: SyncFault | None, gamma: float, ambient: float, noise: float, seed: int) -> Floats:
    """Mean levels that a camera sees; `noise` is that of the lamp, as a share of white."""
    order = fault.shown(GREYS) if fault else list(range(GREYS))
    light = np.array([0.0 if k is None else (SHOWN[k] / 255) ** gamma for k in order])
    lamp = np.random.default_rng(seed).uniform(-noise, noise, GREYS)
    return np.asarray((0.1 + light * (1 + lamp) + ambient) / (1.1 + ambient))


CONDITIONS = st.tuples(st.floats(0.5, 2.4), st.floats(0.0, 3.0), st.floats(0.0, 0.02), st.integers(0, 1000))


def test_the_marker_holds_every_grey_once_and_neighbours_differ_by_a_third() -> None:
    assert sorted(SHOWN.tolist()) == np.rint(np.linspace(0, 255, GREYS)).astype(int).tolist()
    assert np.abs(np.diff(SHOWN)).min() >= 255 / 3
    assert SHOWN[0] > 127 < SHOWN[-1]


@given(CONDITIONS)
def test_levels_that_follow_are_in_step(conditions: tuple[float, float, float, int]) -> None:
    assert matching_faults(SHOWN, levels(None, *conditions)) == ()


@given(st.sampled_from(ALL), CONDITIONS)
def test_every_slip_is_named(fault: SyncFault, conditions: tuple[float, float, float, int]) -> None:
    found = matching_faults(SHOWN, levels(fault, *conditions))
    assert found is not None
    if fault.cause is not Cause.FOREIGN or SHOWN[fault.frame] > 100:  # darkness for a dark grey may pass
        assert fault in found


@pytest.mark.parametrize("cause", [Cause.LATE, Cause.EARLY, Cause.MISSED, Cause.DOUBLED])
def test_a_slip_of_the_trigger_is_named_alone(cause: Cause) -> None:
    for fault in ALL:
        if fault.cause is cause:
            for gamma in (0.5, 1.0, 2.2):
                assert matching_faults(SHOWN, levels(fault, gamma, 0.1, 0.0, 0)) == (fault,)


@pytest.mark.parametrize("missed", range(1, GREYS - 1))
def test_a_missed_trigger_is_named_where_its_frame_never_comes(missed: int) -> None:
    seen = levels(SyncFault(Cause.MISSED, missed), 1.0, 0.1, 0.0, 0)
    seen[-1] = np.nan
    assert matching_faults(SHOWN, seen) == (SyncFault(Cause.MISSED, missed),)


def test_levels_of_something_else_are_not_explained() -> None:
    assert matching_faults(SHOWN, np.random.default_rng(3).uniform(0, 1, GREYS)) is None
