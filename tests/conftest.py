"""Options and fixtures of the whole test suite."""

from __future__ import annotations

import os

import pytest
from hypothesis import settings

# The suite gives the same answer twice. To look for new counterexamples: FPPLAB_EXPLORE=1.
settings.register_profile("same", derandomize=True, deadline=None)
settings.register_profile("explore", max_examples=1000, deadline=None)
settings.load_profile("explore" if os.environ.get("FPPLAB_EXPLORE") else "same")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--rig",
        action="append",
        default=[],
        metavar="FILE",
        help="run the conformance suite on this rig file instead of the ones that need no bench",
    )
