"""Fuzz what reads files and bytes of others.

    python -m tests.fuzz [TARGET …] [--seconds N] [--jobs N]

Each target is run by atheris, guided by the branches of what reads, for 30 minutes or so many seconds.
An exception that is not typed, 5 s without an answer or 2 GB of memory end it, and what did it is left in
build/fuzz; so does a target that ran nothing. Inputs that reach new branches are kept there too, in `corpus`,
and the next run begins with them. An input that is only slow is tried again by itself first, for
other programs may have been at work.
"""

import argparse
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path

from tests.fuzz import seeds
from tests.fuzz.child import EXECUTIONS
from tests.fuzz.targets import TARGETS

ROOT = Path(__file__).parents[2]
FOUND = ROOT / "build" / "fuzz"
CORPUS = FOUND / "corpus"
LEAST_BRANCHES = 20
"""A target of which fewer are seen is not guided."""
LONGEST_S, MOST_MB = 5, 2048
LIMITS = (f"-timeout={LONGEST_S}", f"-rss_limit_mb={MOST_MB}", "-close_fd_mask=1")


@dataclass(frozen=True)
class Outcome:
    """How often a target ran beyond the inputs that it began with, and what is wrong: empty if nothing."""

    name: str
    executions: int
    begun_with: int
    memory_mb: int
    branches: int
    wrong: str

    def __str__(self) -> str:
        figures = f"{self.executions:9} executions beyond {self.begun_with:4} inputs, "
        figures += f"{self.branches:5} branches, {self.memory_mb:5} MB"
        return f"{self.name:12} {figures}  {self.wrong or 'nothing found'}"


def fuzz(name: str, seconds: int) -> Outcome:
    """Run one target for so many seconds."""
    with tempfile.TemporaryDirectory(prefix="fuzz-") as place:
        artefacts, count, corpus = Path(place) / "artefacts", Path(place) / "count", CORPUS / name
        corpus.mkdir(parents=True, exist_ok=True)
        artefacts.mkdir()
        for data in (*TARGETS[name].seeds(), *seeds.kept(name)):
            (corpus / hashlib.sha1(data, usedforsecurity=False).hexdigest()).write_bytes(data)
        begun = len(list(corpus.iterdir()))
        options = [*LIMITS, f"-max_total_time={seconds}", "-max_len=20000", f"-artifact_prefix={artefacts}/"]
        code, said = _run(name, [*options, str(corpus)], count, Path(place), seconds + 600)
        wrong = ""
        for found in sorted(artefacts.iterdir()):
            again = found.name.startswith("timeout-")
            if not again or _run(name, [*LIMITS, str(found)], count, Path(place), 60)[0]:
                kept = FOUND / name / found.name
                kept.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(found, kept)
                wrong = f"{_reason(said)}; see {kept.relative_to(ROOT)}"
        executions = max(0, (int(count.read_text() or 0) if count.exists() else 0) - begun)
    if code and not wrong and "timeout" not in said:
        wrong = f"ended with {code}: {said.strip()[-300:]}"
    branches = _last(r"cov: (\d+)", said)
    if executions < 2:
        wrong = wrong or f"ran {executions} times beyond its corpus: {said.strip()[-300:]}"
    if branches < LEAST_BRANCHES:
        wrong = wrong or f"is guided by {branches} branches: what it reads with is not watched"
    return Outcome(name, executions, begun, _last(r"rss: (\d+)Mb", said), branches, wrong)


def _run(name: str, options: list[str], count: Path, place: Path, limit: float) -> tuple[int, str]:
    command = [sys.executable, "-m", "tests.fuzz.child", name, *options]
    own = {EXECUTIONS: str(count), "TMPDIR": str(place), "OPENBLAS_NUM_THREADS": "1"}
    own["NUMBA_DISABLE_JIT"] = "1"  # numba does not compile what atheris instruments
    environment = {**os.environ, **own}
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, timeout=limit, check=False
        )
    except subprocess.TimeoutExpired:
        return 1, "did not come to an end"
    return done.returncode, done.stderr.decode("utf-8", "replace")


def _reason(said: str) -> str:
    """The exception, or libFuzzer's own word."""
    raised = re.findall(r"^(?:\w+\.)*\w+(?:Error|Exception|Warning)\b.*", said, re.MULTILINE)
    ended = re.findall(r"ERROR: libFuzzer: .*", said)
    return (raised or ended or ["failed"])[0][:200]


def _last(pattern: str, said: str) -> int:
    return max(map(int, re.findall(pattern, said)), default=0)


def main(words: list[str]) -> int:
    """Fuzz targets, and print what came of each."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz")
    parser.add_argument(
        "targets", nargs="*", metavar="TARGET", help=f"of {', '.join(TARGETS)}; by default all"
    )
    parser.add_argument("--seconds", type=int, default=1800, help="for each target")
    parser.add_argument("--jobs", type=int, default=2, help="targets at a time")
    asked = parser.parse_args(words)
    names = asked.targets or list(TARGETS)
    if unknown := set(names) - set(TARGETS):
        parser.error(f"there is no target {', '.join(sorted(unknown))}")
    wrong = 0
    with ThreadPoolExecutor(asked.jobs) as pool:
        for one in as_completed([pool.submit(fuzz, name, asked.seconds) for name in names]):
            print(one.result(), flush=True)
            wrong += bool(one.result().wrong)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
