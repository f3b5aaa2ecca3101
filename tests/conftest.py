"""Options and fixtures of the whole test suite."""

from __future__ import annotations

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--rig",
        action="append",
        default=[],
        metavar="FILE",
        help="run the conformance suite on this rig file instead of the ones that need no bench",
    )
