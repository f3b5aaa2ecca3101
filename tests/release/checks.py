"""The checks of a release. Each gives a complaint, or nothing."""

import re
import subprocess
import sys
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from pathlib import Path

from fpplab.core.version import __version__
from tests.release import licences
from tests.support.commands import ROOT

RELEASED = re.compile(r"^## \[(\d+\.\d+\.\d+)\] - (\d{4}-\d\d-\d\d)$", re.MULTILINE)
DIST = ROOT / "dist"
LONGEST_S = 4 * 3600


@dataclass(frozen=True)
class Check:
    """What has to hold: found out by the function, or confirmed by who releases where there is none."""

    name: str
    what: str
    complain: Callable[[], str] | None = None


def run(*command: str, root: Path = ROOT) -> str:
    """Run a command; the last lines of what it says where it fails."""
    done = subprocess.run(
        command, cwd=root, capture_output=True, text=True, timeout=LONGEST_S, check=False, errors="replace"
    )
    if done.returncode == 0:
        return ""
    said = (done.stdout + done.stderr).strip().splitlines()[-5:]
    return f"{' '.join(command)} ended with {done.returncode}: {' / '.join(said)}"


def uncommitted(root: Path = ROOT) -> str:
    """What git does not know yet."""
    done = subprocess.run(
        ["git", "status", "--porcelain"], cwd=root, capture_output=True, text=True, check=False
    )
    if done.returncode:
        return "git does not answer here: release from a checkout"
    changed = done.stdout.splitlines()
    return f"not committed: {', '.join(line[3:] for line in changed[:5])}" if changed else ""


def versions(root: Path = ROOT) -> str:
    """Whether package, project, citation and change log name one version, and one day."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    citation = (root / "CITATION.cff").read_text(encoding="utf-8")
    cited = re.search(r"^version: (\S+)$", citation, re.MULTILINE)
    cited_day = re.search(r'^date-released: "(\S+)"$', citation, re.MULTILINE)
    logged = RELEASED.search((root / "CHANGELOG.md").read_text(encoding="utf-8"))
    named = {
        "fpplab/core/version.py": __version__,
        "pyproject.toml": project,
        "CITATION.cff": cited and cited.group(1),
        "CHANGELOG.md": logged and logged.group(1),
    }
    if len({*named.values()}) > 1:
        return ", ".join(f"{file} says {version}" for file, version in named.items())
    days = {cited_day and cited_day.group(1), logged and logged.group(2)}
    return f"the days differ: {', '.join(map(str, days))}" if len(days) > 1 else ""


def unreleased(root: Path = ROOT, today: date | None = None) -> str:
    """Whether the change log is closed, with the day of the release."""
    text = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    logged = RELEASED.search(text)
    if logged is None:
        return "CHANGELOG.md has no section of a release"
    before = text[: logged.start()]
    if re.search(r"^- ", before, re.MULTILINE):
        return "CHANGELOG.md has entries under Unreleased; give them the section of this version"
    day = date.fromisoformat(logged.group(2))
    return (
        "" if day == (today or date.today()) else f"CHANGELOG.md dates the release {day}, which is not today"
    )


def bill_of_materials() -> str:
    """Write all installed packages and their licences to `dist/`."""
    out = DIST / f"fpplab-{__version__}.cdx.json"
    DIST.mkdir(exist_ok=True)
    program = str(Path(sys.executable).parent / "cyclonedx-py")
    words = ("--pyproject", "pyproject.toml", "--output-reproducible", "--of", "JSON", "-o", str(out))
    return run(program, "environment", sys.prefix, *words)


def python(*words: str) -> Callable[[], str]:
    """A check that this Python runs a command without complaint."""
    return lambda: run(sys.executable, *words)


def pytest(path: str) -> Callable[[], str]:
    """A check that tests pass."""
    return python("-m", "pytest", "-q", path)


WHEEL = ("-m", "pip", "wheel", "-q", "--no-deps", "-w", "dist", ".")
CHECKS = (
    Check("clean", "everything is committed", uncommitted),
    Check("versions", "one version, and one day, in all files that name it", versions),
    Check("changes", "the change log is closed, with the day of the release", unreleased),
    Check("licences", "docs/licences.md tells all dependencies", lambda: "; ".join(licences.complaints())),
    Check("lint", "lint, types and import contracts", lambda: run("make", "lint")),
    Check("formats", "files of all versions are read", pytest("tests/sessions/test_version_0_1_0.py")),
    Check("docs", "generated pages are up to date", pytest("tests/docs")),
    Check("quick", "the quick tests", lambda: run("make", "test")),
    Check(
        "whole", "tests that a merge waits for, among them the wheel alone", lambda: run("make", "test-whole")
    ),
    Check("nightly", "repeats, rare conditions and long runs", lambda: run("make", "nightly")),
    Check("wheel", "the wheel is in dist/", python(*WHEEL)),
    Check("materials", "the bill of materials is in dist/", bill_of_materials),
    Check("other", "the twin on the other Python: `make test-twin VENV=.venv-other PYTHON=python3.11`"),
    Check("bench", "`pytest tests/conformance --rig RIG` on a real bench"),
    Check("removed", "whatever this version removes was announced in the change log one version before"),
)
