"""Libraries in a process of their own: they answer, crash, block and print, and nothing here is harmed."""

import os
import subprocess
import sys
import time
from multiprocessing.connection import Connection
from pathlib import Path

import pytest

from drivers.apart import ask_apart
from tests.support.commands import ROOT


def doubled(connection: Connection, word: str) -> None:
    connection.send(2 * word)


def crashing(connection: Connection) -> None:
    os.abort()


def blocking(connection: Connection) -> None:
    time.sleep(60)


def test_an_answer_comes_back() -> None:
    assert ask_apart(doubled, "ab", timeout_s=60.0) == "abab"


def test_a_user_s_script_is_not_run_again(tmp_path: Path) -> None:
    """It need not be `if __name__ == "__main__"`."""
    (tmp_path / "script.py").write_text(
        "from multiprocessing.connection import Connection\nfrom drivers.apart import ask_apart\n"
        "print(ask_apart(Connection.send, 5, timeout_s=60))\n"
    )
    command, environment = (
        [sys.executable, str(tmp_path / "script.py")],
        {**os.environ, "PYTHONPATH": str(ROOT)},
    )
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("5\n", "")


@pytest.mark.whole
def test_one_that_crashes_or_blocks_gives_none(capfd: pytest.CaptureFixture[str]) -> None:
    assert ask_apart(crashing, timeout_s=60.0) is None
    begin = time.monotonic()
    assert ask_apart(blocking, timeout_s=0.1) is None
    assert time.monotonic() - begin < 30.0


SPEAKING = """
import os, sys
from drivers.apart import native_stderr_silenced
with native_stderr_silenced():
    os.write(2, b"library\\n")
    print("python", file=sys.stderr)
os.write(2, b"afterwards\\n")
"""


def test_what_a_library_prints_does_not_appear_and_what_python_says_does() -> None:
    done = subprocess.run([sys.executable, "-c", SPEAKING], capture_output=True, text=True, check=True)
    assert done.stderr == "python\nafterwards\n"


LISTING = """
from drivers.display.window import connected_displays
from fpplab.core.errors import DeviceError
if __name__ == "__main__":
    try:
        connected_displays()
    except DeviceError as error:
        print(error.found)
"""


def test_sdl_looks_for_displays_without_a_word(tmp_path: object) -> None:
    """Without a session it says on the terminal what each of its video drivers lacks."""
    lacking = {"DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR", "SDL_VIDEODRIVER"}
    environment = {name: value for name, value in os.environ.items() if name not in lacking}
    done = subprocess.run(
        [sys.executable, "-c", LISTING],
        capture_output=True,
        text=True,
        check=True,
        env=environment | {"SDL_VIDEODRIVER": "wayland"},
    )
    assert done.stdout == "SDL finds no displays (wayland not available)\n"
    assert done.stderr == ""
