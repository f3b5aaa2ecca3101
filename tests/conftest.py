"""Options and fixtures of the whole test suite."""

from __future__ import annotations

import fcntl
import gc
import json
import os
import random
import signal
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import pytest
from hypothesis import settings

from fpplab.core import foreign
from fpplab.core.files import open_regular
from tests.support.commands import ROOT, Command, Demo, ready_program, run
from tests.support.ready_program import reuse_commands

if TYPE_CHECKING:
    from sim.worker import Blender

# Workers of a parallel run ignore Ctrl-C, as background jobs of a shell do, and what they start inherits it.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Benches that tests bring themselves are backends of no installed package.
os.environ["FPPLAB_ALLOW_BACKEND"] = ",".join(
    filter(None, [os.environ.get("FPPLAB_ALLOW_BACKEND"), "tests,acme_camera"])  # beside what a user allows
)

ready_program()  # knows this environment as the suite's
reuse_commands()

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
        help="run the conformance suite on this rig file only, instead of those that need no bench; "
        "its tests that bring devices of their own are left out",
    )
    parser.addoption(
        "--own-devices",
        action="store_true",
        help="with --rig: also run the conformance tests that bring devices of their own",
    )
    parser.addoption(
        "--shuffle",
        type=int,
        metavar="SEED",
        help="run files, and the tests of each, in a random order: no test may depend on those before it",
    )


@pytest.hookimpl(tryfirst=True)
def pytest_collection() -> None:
    """Look for no garbage while tests are collected: every search would go through all that is kept."""
    gc.disable()


def pytest_collection_finish() -> None:
    """What was collected stays to the end, and no search has to go through it again."""
    gc.freeze()
    gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what asks for the demonstration, and the cases after the first ones of `whole_after`."""
    cases = Counter[str]()
    for item in items:
        function = item.nodeid.partition("[")[0]
        cases[function] += 1
        after = item.get_closest_marker("whole_after")
        marked = item.get_closest_marker("whole") or item.get_closest_marker("nightly")
        if "demo" in getattr(item, "fixturenames", ()) and not marked:
            item.add_marker(pytest.mark.demonstration)
            item.add_marker(pytest.mark.whole)
        if after and cases[function] > after.args[0]:
            is_rare = cases[function] > after.kwargs.get("nightly", cases[function])
            item.add_marker(pytest.mark.nightly if is_rare else pytest.mark.whole)
        if item.get_closest_marker("whole") or item.get_closest_marker("nightly"):
            item.add_marker(pytest.mark.slow)
    if (seed := config.getoption("--shuffle")) is not None:
        order = random.Random(seed)
        files = {path: order.random() for path in sorted({item.path for item in items})}
        items.sort(key=lambda item: (files[item.path], order.random()))


@pytest.fixture(scope="session")
def fpplab() -> Command:
    """The program."""
    return run


@pytest.fixture(scope="session")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Demo:
    """`fpplab demo --quick --json`, run once for all workers of a run; nobody changes its files."""
    shared = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        shared = shared.parent
    folder, answer = shared / "demo", shared / "demo.json"
    with (shared / "demo.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not answer.exists():
            done = run("demo", "--quick", "--json", "--out", folder)
            assert done.code == 0, done.err
            answer.write_text(done.out)
    return Demo(folder, json.loads(answer.read_text()))


@pytest.fixture
def foreign_files_read_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Foreign parsers run in this process, not in one of their own (tests/core/test_foreign.py has that)."""

    def read_here(kind: str, path: Path, opened: BinaryIO | None = None) -> foreign.Parts:
        with opened or open_regular(path) as stream:
            read = foreign._read(kind, stream)
        if isinstance(read, str):
            raise ValueError(read)
        return read

    for reader in ("fpplab.clouds.files", "fpplab.calibration.dialects", "fpplab.phase.phase_maps"):
        monkeypatch.setattr(f"{reader}.read_apart", read_here)


@pytest.fixture(scope="session")
def captures() -> Path:
    """Recorded captures of a real rig, where this computer has them."""
    folder = Path(os.environ.get("FPPLAB_DATA", ROOT.parent / "shared" / "data")) / "slstudio"
    if not folder.is_dir():
        pytest.skip(f"no recorded captures at {folder}; set FPPLAB_DATA to the folder that holds them")
    return folder


@pytest.fixture(scope="session")
def blender() -> Iterator[Blender]:
    """One Blender process for all tests of a worker: it knows nothing but the scene it was last sent."""
    from sim.worker import Blender  # here, for most runs of a few tests need no Blender

    process = Blender("bench")
    yield process
    process.close()
