"""The conformance suite notices seeded faults, and nothing where there is none.

A twentieth of the faults is tried here, and each that is new; `make faults` tries all of them.
"""

from __future__ import annotations

import pytest

from tests.conformance.fault import Fault
from tests.conformance.fault_list import FAULTS
from tests.conformance.seeded_faults import SUITES, Verdict, first_to_fail, try_fault, try_none

pytestmark = pytest.mark.nightly


PLACES = list({suite: place for place, suite in SUITES.items()}.values())
"""A suite that serves several places passes once."""


@pytest.mark.parametrize("place", PLACES[::6])  # the others pass as part of the quick tests, if not in a copy
def test_an_unharmed_copy_passes(place: str) -> None:
    trial = try_none(place)
    assert trial.verdict is Verdict.SURVIVED, trial.evidence


EVERY = 20
TRIED = [one for k, one in enumerate(FAULTS) if k % EVERY == 0 or one.name not in first_to_fail()]


@pytest.mark.parametrize("fault", TRIED, ids=lambda fault: fault.name)
def test_a_fault_is_killed(fault: Fault) -> None:
    trial = try_fault(fault)
    assert trial.verdict is Verdict.KILLED, trial.evidence
