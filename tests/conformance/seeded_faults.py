"""Mutation test of the conformance suite: faults seeded into a copy of the sources, one at a time.

    python -m tests.conformance.seeded_faults [PART OF A NAME …]

Each fault is one of the mistakes that are made when devices are driven. The suite must fail on
every copy that holds one, and pass on the copy that holds none.

The test that failed first when the suite was last run whole is tried by itself before the others: it is
listed in `first_to_fail.json`, which a run without words writes anew. A list that is out of date only costs
time.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from tests.conformance.fault import Fault
from tests.conformance.fault_list import FAULTS
from tests.conformance.fragments import replace

ROOT = Path(__file__).parents[2]
COPIED = ("fpplab", "drivers", "sim", "configs", "tests", "pyproject.toml")
NOT_COPIED = shutil.ignore_patterns(".*", "*.pyc.*", "*.tmp.*")
"""What is compiled is copied too, for it is valid in a copy whose files are as old; not drafts of it."""
SECONDS = 900
FIRST_TO_FAIL = Path(__file__).with_name("first_to_fail.json")
"""By fault, the test that failed first."""


class Verdict(StrEnum):
    """What became of a fault."""

    KILLED = "killed"
    SURVIVED = "SURVIVED"
    BROKEN = "BROKEN"
    """The suite could not run, or not to its end, which proves nothing."""


@dataclass(frozen=True)
class Trial:
    """A verdict, and the test that reached it."""

    name: str
    verdict: Verdict
    evidence: str


@dataclass(frozen=True)
class Suite:
    """What judges a fault: the conformance suite on the fastest rigs where it shows, and a driver's own."""

    rigs: tuple[str, ...]
    tests: tuple[str, ...] = ()


NODE_MAPS = Suite(
    ("rig_pylon.yaml",),
    (
        *("test_pixels.py", "test_basler_families.py", "test_basler_features.py"),
        *("test_basler.py", "test_basler_faults.py"),
    ),
)
VIDEO_PORT = Suite(("rig_dlp4500_video.yaml",), ("dlp4500/test_video.py",))
TRIGGER_CHECK = Suite(
    ("rig_reference.yaml",),
    ("../setup/rig_check/test_exposure_shift.py", "test_emulated_check.py", "test_emulated_steps.py"),
)
DISPLAY = Suite(("rig_reference.yaml",), ("test_display_device.py", "test_display_window.py"))
FOUND = Suite(("rig_reference.yaml",), ("test_discovery.py",))
SET_UP = Suite(("rig_reference.yaml",), ("../setup/test_new_rig.py",))
LOCKS = Suite(
    ("rig_reference.yaml",),
    ("../core/test_lock.py", "../sessions/test_lock.py", "../setup/live/test_keys.py"),
)
SUITES = {
    "sim/": Suite(("rig_simulated.yaml",)),
    "drivers/basler/": NODE_MAPS,
    "drivers/genicam/": NODE_MAPS,
    "drivers/gentl/": Suite(("rig_gentl.yaml",), ("test_pixels.py", "test_gentl.py")),
    "drivers/video_camera/": Suite(("rig_video.yaml",), ("test_video_camera.py",)),
    "drivers/dlp4500/on_video.py": VIDEO_PORT,
    "drivers/display/": DISPLAY,
    "fpplab/devices/flashing.py": DISPLAY,
    "drivers/computer_discovery.py": FOUND,
    "drivers/discovery.py": FOUND,
    "fpplab/setup/display_timing.py": Suite(("rig_reference.yaml",), ("../setup/test_display_timing.py",)),
    "fpplab/setup/new_rig.py": SET_UP,
    "fpplab/cli/commands/rig.py": SET_UP,
    "fpplab/core/lock.py": LOCKS,
    "fpplab/setup/live/keys.py": LOCKS,
    "drivers/dlp4500/": Suite(
        ("rig_dlp4500.yaml",),
        tuple(
            f"dlp4500/test_{name}.py"
            for name in ("packets", "sequence", "transport", "device", "start", "board", "faults")
        ),
    ),
    "drivers/stage_grbl/": Suite(("rig_grbl.yaml",), ("test_stage_grbl.py",)),
    "fpplab/acquisition/timing.py": Suite(
        ("rig_reference.yaml",), ("../acquisition/test_timing.py", "../cli/test_plan.py")
    ),
    "fpplab/setup/rig_check/exposure_shift.py": TRIGGER_CHECK,
    "fpplab/setup/rig_check/marker_check.py": TRIGGER_CHECK,
    "fpplab/setup/rig_check/steps.py": TRIGGER_CHECK,
    "": Suite(("rig_reference.yaml", "rig_replay.yaml")),
}
"""By where the fault is: the first that fits."""


@contextmanager
def copy_of_the_tree() -> Iterator[Path]:
    """The sources in a temporary folder."""
    with tempfile.TemporaryDirectory(prefix="seeded-") as folder:
        for name in COPIED:
            source, copy = ROOT / name, Path(folder) / name
            if source.is_dir():
                shutil.copytree(source, copy, ignore=NOT_COPIED)
            else:
                shutil.copy(source, copy)
        yield Path(folder)


def seed(tree: Path, fault: Fault) -> None:
    """Put a fault into a copy; `LookupError` unless its place is found exactly once."""
    path = tree / fault.file
    path.write_text(seeded(fault, path.read_text(encoding="utf-8")), encoding="utf-8")


def seeded(fault: Fault, source: str) -> str:
    """The source of a fault's file with the fault in it; `LookupError` as for `seed`."""
    try:
        return replace(source, fault.within, fault.old, fault.new)
    except LookupError as error:
        raise LookupError(f"the fault '{fault.name}' in {fault.file}: {error}") from error


def run_suite(tree: Path, suite: Suite, only: str | None = None) -> tuple[Verdict, str]:
    """The suite, or one test of it, on the copy, up to its first failure."""
    tests = [only] if only else [*(f"tests/drivers/{test}" for test in suite.tests), "tests/conformance"]
    command = [sys.executable, "-m", "pytest", *tests, "-x", "-q", "-m", "not nightly"]
    command += ["-p", "no:cacheprovider", "--no-header", "--tb=no", "--own-devices"]
    command += [word for rig in suite.rigs for word in ("--rig", f"tests/conformance/rigs/{rig}")]
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(
            command, cwd=tree, env=environment, capture_output=True, text=True, timeout=SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        return Verdict.BROKEN, f"still running after {SECONDS} s"
    output = (done.stdout + done.stderr).strip().splitlines()
    failed = [line for line in output if line.startswith(("FAILED", "ERROR")) and "::" in line]
    if done.returncode == 1 and failed:
        return Verdict.KILLED, failed[0].split(" - ")[0]
    return Verdict.SURVIVED if done.returncode == 0 else Verdict.BROKEN, output[-1]


def suite_for(fault: Fault) -> Suite:
    """The fastest suite in which a fault can show."""
    return next(suite for place, suite in SUITES.items() if fault.file.startswith(place))


def try_fault(fault: Fault) -> Trial:
    """Seed one fault and let the suite judge."""
    with copy_of_the_tree() as tree:
        seed(tree, fault)
        suite, likely = suite_for(fault), first_to_fail().get(fault.name)
        if likely:
            verdict, evidence = run_suite(tree, suite, likely)
            if verdict is Verdict.KILLED:
                return Trial(fault.name, verdict, evidence)
        return Trial(fault.name, *run_suite(tree, suite))


def first_to_fail() -> dict[str, str]:
    """By fault, the test that failed first when the suite was last run whole."""
    found: dict[str, str] = json.loads(FIRST_TO_FAIL.read_text(encoding="utf-8"))
    return found


def try_none(place: str) -> Trial:
    """The suite that judges faults in a place, on an unharmed copy."""
    with copy_of_the_tree() as tree:
        return Trial(f"no fault at all in {place or 'fpplab/'}", *run_suite(tree, SUITES[place]))


def main(words: list[str]) -> int:
    """Try the faults whose names hold every word, and unharmed copies by the same suites."""
    chosen = [f for f in FAULTS if all(word in f.name for word in words)]
    killed, sound, first = 0, True, dict[str, str]()
    judges = [suite_for(fault) for fault in chosen]
    for place in (place for place, suite in SUITES.items() if suite in judges):
        unharmed = try_none(place)
        passes = unharmed.verdict is Verdict.SURVIVED
        print(f"{'passes' if passes else 'FAILS':8}  {unharmed.name}", flush=True)
        sound &= passes
    with ThreadPoolExecutor(max_workers=2) as pool:
        for trial in pool.map(try_fault, chosen):
            killed += trial.verdict is Verdict.KILLED
            first[trial.name] = trial.evidence.partition(" ")[2]
            print(f"{trial.verdict:8}  {trial.name}\n{'':10}{trial.evidence}", flush=True)
    print(f"{killed} of {len(chosen)} faults killed")
    if not words and killed == len(chosen):
        FIRST_TO_FAIL.write_text(json.dumps(first, indent=1) + "\n", encoding="utf-8")
    return 0 if killed == len(chosen) and sound else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
