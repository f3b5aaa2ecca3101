"""One target under atheris, in a process of its own: `python -m tests.fuzz.child TARGET [OPTION …] FOLDER …`.

Options are libFuzzer's. How many times the target was run is written to the file that the environment names.
"""

import os
import sys
import tempfile
from pathlib import Path

import atheris

EXECUTIONS = "FPPLAB_FUZZ_EXECUTIONS"
"""Environment: the file for the number of executions."""
OFTEN = 20
"""The number is written every so many times."""


def main(words: list[str]) -> None:
    """Fuzz until libFuzzer ends the process."""
    from tests.fuzz.targets import TARGETS

    target, count = TARGETS[words[1]], Path(os.environ[EXECUTIONS])
    done = 0
    folder = Path(tempfile.mkdtemp(prefix=f"fuzz-{words[1]}-", dir=os.environ.get("TMPDIR")))
    with atheris.instrument_imports(include=list(target.guided_by)):
        for data in target.seeds():  # what reads it is imported now, which takes its time
            target(data, folder)

    def one(data: bytes) -> None:
        nonlocal done
        done += 1
        if done % OFTEN == 1:
            count.write_text(str(done))
        target(data, folder)

    atheris.SceneState([words[0], *words[2:]], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv)
