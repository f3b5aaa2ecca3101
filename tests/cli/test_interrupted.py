"""Whole commands: signals at any moment of their lives, and streams that take nothing."""

import json
import os
import signal
import subprocess
import sys
import time
from itertools import cycle
from pathlib import Path

import pytest

from benchmarks.crash.signals import FIRST_LINE
from tests.support.commands import ROOT, Command

MOMENTS = [n / 20 for n in range(20)]
"""In parts of the time that a run takes, which depends on what else the machine does."""
PROGRAM = [sys.executable, "-m", "fpplab"]


@pytest.mark.whole
def test_a_signal_at_any_moment_of_a_short_command() -> None:
    """Before the first line of the program Python answers itself: by its death, or showing where it was."""
    begun, codes = time.monotonic(), []
    subprocess.run([*PROGRAM, "plan", "--help"], cwd=ROOT, capture_output=True, check=True, timeout=60)
    seconds = time.monotonic() - begun
    for moment, number in zip(MOMENTS, cycle([signal.SIGINT, signal.SIGTERM, signal.SIGHUP])):
        with subprocess.Popen(
            [*PROGRAM, "plan", "--help"], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        ) as process:
            time.sleep(max(0.001, moment * seconds))
            process.send_signal(number)
            out, err = process.communicate(timeout=60)
        places = [line for line in err.splitlines() if "/fpplab/" in line]
        own = "Traceback" in err and all(FIRST_LINE.fullmatch(line) for line in places)
        assert "Traceback" not in err or own, (moment, err)
        assert process.returncode in (0, 130, -number) or own, (moment, number, err)
        assert process.returncode != 0 or "Usage" in out
        codes.append(process.returncode)
    assert 130 in codes


LOADING = """
import os, signal, sys
signal.signal(signal.{number}, signal.SIG_DFL)  # it is ignored where the tests run in the background
sys.argv = ["fpplab", "plan", "--help"{more}]
class Hit:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.kill(os.getpid(), signal.{number})
sys.meta_path.insert(0, Hit())
from fpplab.core import interrupts
interrupts.AGAIN_S = {again_s}
from fpplab.__main__ import main
main()
"""


@pytest.mark.parametrize("again_s", [0.02, 30.0])
@pytest.mark.parametrize(
    ("module", "number"),
    [("fpplab.cli", "SIGINT"), ("typer", "SIGTERM"), ("rich.console", "SIGHUP")],
)
def test_a_signal_while_modules_are_loaded(module: str, number: str, again_s: float) -> None:
    """It is raised later, or, on a machine that is too busy for that, heard when the command has ended."""
    code = LOADING.format(module=module, number=number, again_s=again_s, more=', "--json"')
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 130, done.stderr
    assert done.stderr == "fpplab: cancelled\n"
    assert json.loads(done.stdout) == {"error": "cancelled", "exit_code": 130}


def test_stdout_that_takes_nothing() -> None:
    with open("/dev/full", "w", encoding="utf-8") as full:
        done = subprocess.run(
            [*PROGRAM, "--help"], cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 4
    assert "could not be written to stdout (No space left on device)" in done.stderr
    assert "Traceback" not in done.stderr
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as nobody:
        done = subprocess.run(
            [*PROGRAM, "--help"], cwd=ROOT, stdout=nobody, stderr=subprocess.PIPE, text=True, check=False
        )
    assert done.returncode == 4
    assert done.stderr.count("\n") == 1
    closed = subprocess.run(
        ["/bin/sh", "-c", 'exec "$@" >&-', "sh", *PROGRAM, "--help"],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    assert (closed.returncode, closed.stderr) == (0, "")


@pytest.mark.parametrize("option", ["--rig", "--out"])
def test_names_that_no_file_can_have(fpplab: Command, option: str, tmp_path: Path) -> None:
    words = {"--rig": "rig_demo", "--calibration": str(tmp_path), "--out": str(tmp_path / "s")}
    long = fpplab("scan", *(w for pair in (words | {option: "x" * 300}).items() for w in pair), "--json")
    assert long.code == 2
    odd = os.fsdecode(b"odd\xff.yaml")
    none = fpplab("scan", *(w for pair in (words | {option: odd}).items() for w in pair), "--json")
    assert none.code == 2
    assert none.json["error"] == "odd?.yaml: is not text in UTF-8; rename the file"


@pytest.mark.whole
def test_the_working_directory_holds_no_libraries(tmp_path: Path) -> None:
    for name in ("signal", "threading", "typer", "numpy", "mine"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('imported')\n", encoding="utf-8")
    (tmp_path / "rig.yaml").write_text(
        'name: odd\ncamera: {backend: "mine:C"}\nprojector: {backend: "mine:P"}\n', encoding="utf-8"
    )
    command = [*PROGRAM, "--allow-backend", "mine", "check", "--rig", "rig.yaml"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False, timeout=60
    )
    assert done.returncode == 2, done.stderr
    assert "cannot be loaded (No module named 'mine')" in done.stderr


FIRST = """
import sys
sys.path.insert(0, sys.argv[1])
before = {*sys.modules}
import _signal
def heard(*_):
    print(*sorted({*sys.modules} - before))
    sys.exit()
_signal.signal = heard
from fpplab.__main__ import main
main()
"""


def test_signals_are_heard_before_anything_is_loaded() -> None:
    """Until then a signal ends Python itself, by its number: little may lie before."""
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", FIRST, str(ROOT)], capture_output=True, text=True, check=True
    )
    loaded = done.stdout.split()
    assert "fpplab.__main__" in loaded
    assert not {"signal", "enum", "typing", "re", "threading", "contextlib"} & {*loaded}
    own = {name for name in loaded if name.startswith("fpplab")}
    assert own == {"fpplab", "fpplab.__main__", "fpplab.core", "fpplab.core.version"}
