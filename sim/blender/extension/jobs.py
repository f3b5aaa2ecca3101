"""fpplab in a process of its own, started and watched from Blender."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import Any

_running: set[Job] = set()


class JobFailedError(Exception):
    """A command failed or could not be started; one sentence says why."""


class Job:
    """One command of fpplab, running; all temporary files are in a folder of its own, until `close`."""

    def __init__(self, interpreter: str, arguments: list[str]) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="fpplab-"))
        command = [argument.replace("{folder}", str(self.folder)) for argument in arguments]
        environment = {**os.environ, **dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(self.folder))}
        try:
            with self._out.open("wb") as out, self._err.open("wb") as err:
                self._process = subprocess.Popen(
                    [interpreter, "-P", "-m", "fpplab", *command, "--json"],
                    stdin=subprocess.DEVNULL,
                    stdout=out,
                    stderr=err,
                    env=environment,
                )
        except OSError as error:
            shutil.rmtree(self.folder, ignore_errors=True)
            raise JobFailedError(f"{interpreter} cannot be started: {error.strerror}") from error
        _running.add(self)

    @property
    def _out(self) -> Path:
        return self.folder / "stdout"

    @property
    def _err(self) -> Path:
        return self.folder / "stderr"

    def is_done(self) -> bool:
        return self._process.poll() is not None

    def wait(self) -> None:
        self._process.wait()

    def last_line(self) -> str:
        """Give the last line that the command said about its progress."""
        lines = self._err.read_text(encoding="utf-8", errors="replace").split("\n")
        return next((line.strip() for line in reversed(lines) if line.strip()), "")

    def answer(self) -> dict[str, Any]:
        """Give the result of the command, which has ended."""
        try:
            output = json.loads(self._out.read_text(encoding="utf-8"))
        except ValueError:
            output = {}
        if self._process.returncode == 0 and isinstance(output, dict) and output:
            return output
        said = output.get("error") if isinstance(output, dict) else None
        raise JobFailedError(
            str(said or self.last_line() or f"fpplab ended with exit code {self._process.returncode}")
        )

    def close(self) -> None:
        """End the command if it still runs, and remove its folder; allowed any number of times."""
        if not self.is_done():
            self._process.send_signal(signal.SIGTERM if os.name == "nt" else signal.SIGINT)
            try:
                self._process.wait(timeout=10.0)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)
        _running.discard(self)


def end_all() -> None:
    for job in list(_running):
        job.close()
