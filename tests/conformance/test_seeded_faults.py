"""The conformance suite notices every seeded fault, and nothing where there is none."""

from __future__ import annotations

import pytest

from tests.conformance.fault import Fault
from tests.conformance.fault_list import FAULTS
from tests.conformance.seeded_faults import SUITES, Verdict, try_fault, try_none

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("place", SUITES)
def test_an_unharmed_copy_passes(place: str) -> None:
    trial = try_none(place)
    assert trial.verdict is Verdict.SURVIVED, trial.evidence


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_every_fault_is_killed(fault: Fault) -> None:
    trial = try_fault(fault)
    assert trial.verdict is Verdict.KILLED, trial.evidence
