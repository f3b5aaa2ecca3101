"""What was judged, one line of a file for each bench, so that an interrupted run goes on where it stopped."""

import json
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter

from benchmarks.diagnosis.advice import Followed, follow
from benchmarks.diagnosis.judging import Judged
from fpplab.core.errors import ConfigError

T = TypeVar("T", Judged, Followed)
Key = tuple[str, str, int]
"""Name of the judge, cause and seed."""


class Record:
    """Outcomes in a file of JSON lines, the first of which names the commit."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[Key, Any] = {}
        commit = {"commit": commit_of_checkout()}
        if not path.exists():
            path.write_text(json.dumps(commit) + "\n")
            return
        head, *lines = _whole_lines(path)
        if head != commit:
            theirs = head.get("commit", "unknown")
            raise ConfigError(
                f"{path}: is of commit {theirs}, and this is commit {commit['commit']}; name another file"
            )
        for line in lines:
            judge, cause, seed = line["of"]
            kind = Followed if judge == follow.__name__ else Judged
            self._known[judge, cause, seed] = TypeAdapter[Any](kind).validate_python(line["outcome"])

    def known(self, judge: Callable[[str, int], T], cause: str, seed: int) -> T | None:
        """Find an outcome that an earlier run has left."""
        return self._known.get((judge.__name__, cause, seed))

    def add(self, judge: Callable[[str, int], T], cause: str, seed: int, outcome: T) -> None:
        """Write an outcome down."""
        line = {"of": [judge.__name__, cause, seed], "outcome": asdict(outcome)}
        with self._path.open("a") as file:
            file.write(json.dumps(line) + "\n")


def commit_of_checkout() -> str:
    """Ask git for the commit of this checkout."""
    command = ["git", "describe", "--always", "--dirty", "--exclude", "*"]
    done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True, check=False)
    return done.stdout.strip() or "unknown"


def _whole_lines(path: Path) -> Iterator[dict[str, Any]]:
    """Lines of a record; of the last one a killed run may have written a part, which is dropped."""
    text = path.read_text()
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole)
    try:
        yield from (json.loads(line) for line in whole.splitlines() or ["{}"])
    except ValueError as error:
        raise ConfigError(f"{path}: is no record of judged benches ({error})") from error
