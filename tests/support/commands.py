"""Whole commands, run as a user runs them."""

import atexit
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from tests.support.ready_program import ReadyProgram

ROOT = Path(__file__).parents[2]
LONGEST_S = 540.0
NO_DISPLAY = {"DISPLAY": "", "WAYLAND_DISPLAY": ""}
"""Environment in which the viewer is a page, not a window."""


@dataclass(frozen=True)
class Outcome:
    """What a command left: exit code, stdout, stderr."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> dict[str, Any]:
        """stdout as exactly one JSON object."""
        answer = json.loads(self.out)
        assert isinstance(answer, dict)
        return answer


Command = Callable[..., Outcome]


@cache
def ready_program() -> ReadyProgram:
    """The process that commands are forked from, with the environment of the first call."""
    ready = ReadyProgram(ROOT)
    atexit.register(ready.close)
    return ready


def run(*words: object, cwd: Path | None = None, env: dict[str, str] | None = None) -> Outcome:
    """`python -m fpplab WORDS`, without a traceback whatever happens."""
    given, environment = [str(word) for word in words], {**os.environ, **(env or {})}
    if ready_program().fits(environment):
        done = ready_program().run(given, cwd or ROOT, environment, LONGEST_S)
    else:
        done = subprocess.run(
            [sys.executable, "-m", "fpplab", *given],
            check=False,
            capture_output=True,
            text=True,
            cwd=cwd or ROOT,
            env=environment,
            timeout=LONGEST_S,
        )
    assert "Traceback" not in done.stderr, done.stderr
    return Outcome(done.returncode, done.stdout, done.stderr)


@dataclass(frozen=True)
class Demo:
    """The quick demonstration's folder and answer."""

    folder: Path
    answer: dict[str, Any]
