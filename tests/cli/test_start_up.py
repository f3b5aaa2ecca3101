"""What a command loads before its work: a mistyped name is answered without the libraries that compute."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command

from benchmarks.commands import every_command
from fpplab.cli.every import app
from tests.support.commands import ROOT

NEEDED_TO_REFUSE = {
    "artefact": {"numpy"},  # whose shapes know their parameters
}
"""Libraries that a command has loaded when it is given files that do not exist."""
HEAVY = {"cv2", "matplotlib", "multiprocessing", "numba", "numpy", "pypylon", "scipy", "tifffile", "trimesh"}
FORKS = f"""
import json, os, sys
import fpplab.cli
from fpplab.__main__ import main
before = set(sys.modules)
for words in json.load(sys.stdin):
    print(end="", flush=True)
    if os.fork():
        os.wait()
        continue
    sys.argv = ["fpplab", *words]
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    answer = os.dup(1)
    os.dup2(2, 1)
    try:
        main()
    finally:
        loaded = sorted({HEAVY} & {{name.partition(".")[0] for name in sys.modules}})
        os.write(answer, (json.dumps([words, loaded]) + "\\n").encode())
        os._exit(0)
"""


@pytest.mark.whole
def test_a_missing_file_is_refused_before_what_computes_is_loaded(tmp_path: Path) -> None:
    given = [words for words, needs_input in every_command(get_command(app), []) if needs_input]
    done = subprocess.run(
        [sys.executable, "-c", FORKS],
        cwd=tmp_path, env={**os.environ, "PYTHONPATH": str(ROOT)}, input=json.dumps(given),
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    loaded = {" ".join(words): set(modules) for words, modules in map(json.loads, done.stdout.splitlines())}
    assert len(loaded) == len(given) > 30
    wrong = {
        words: modules
        for words, modules in loaded.items()
        if modules - NEEDED_TO_REFUSE.get(words.split()[0], set())
    }
    assert not wrong


SCAN_SHOWN = """
import sys
from types import SimpleNamespace
from fpplab.cli.viewing import MeasurementObserver
from fpplab.results.scan import ScanResult
result = object.__new__(ScanResult)
vars(result).update(diagnosis=SimpleNamespace(is_useless=True), cloud=None)
MeasurementObserver.console().result(result)
print("trimesh" in sys.modules)
"""


@pytest.mark.whole
def test_a_scan_is_shown_without_what_compares_shapes() -> None:
    done = subprocess.run([sys.executable, "-c", SCAN_SHOWN], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
