"""A pytest plugin that tells the recording of executed lines, also of child processes, which test runs.

It appends each test's result and time to the file that the environment names.
"""

import json
import os
from collections.abc import Generator
from pathlib import Path

import coverage
import pytest

CONTEXT, RESULTS, KNOWN = "FPPLAB_MUTANTS_TEST", "FPPLAB_MUTANTS_RESULTS", "FPPLAB_MUTANTS_KNOWN"
"""Environment: the test that runs, the file of results, and that of tests that need not run again."""


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    known = set(Path(os.environ[KNOWN]).read_text("utf-8").splitlines())
    config.hook.pytest_deselected(items=[item for item in items if item.nodeid in known])
    items[:] = [item for item in items if item.nodeid not in known]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    os.environ[CONTEXT] = item.nodeid
    if (recorder := coverage.Coverage.current()) is not None:
        recorder.switch_context(item.nodeid)
    return (yield)


_seconds: dict[str, float] = {}
_failed: set[str] = set()


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    if "PYTEST_XDIST_WORKER" in os.environ:
        return  # the process that began the tests hears of it too
    _seconds[report.nodeid] = _seconds.get(report.nodeid, 0.0) + report.duration
    if not report.passed:
        _failed.add(report.nodeid)
    if report.when == "teardown":
        result = {
            "test": report.nodeid,
            "seconds": round(_seconds.pop(report.nodeid), 3),
            "passed": report.nodeid not in _failed,
        }
        with Path(os.environ[RESULTS]).open("a", encoding="utf-8") as file:
            file.write(json.dumps(result) + "\n")
