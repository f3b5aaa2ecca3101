"""Signals at the moments at which Python loses them; whole commands are interrupted in tests/cli."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

BEGIN = """
import os, signal, sys, time, weakref
from fpplab.core import interrupts
signal.signal(signal.SIGHUP, signal.SIG_DFL)  # of tests under nohup it is ignored
interrupts.watch_signals()
class Thing: pass
def hit(number=signal.SIGINT):
    os.kill(os.getpid(), number)
def wait():
    for _ in range(300): time.sleep(0.01)
    print("never stopped")
"""

MOMENTS = {
    "in a weak reference's callback": """
thing = Thing()
ref = weakref.ref(thing, lambda _: hit(signal.SIGTERM))
try:
    del thing
    wait()
except KeyboardInterrupt:
    print("stopped")
""",
    "while an object is deleted": """
Thing.__del__ = lambda self: hit()
try:
    Thing()
    wait()
except KeyboardInterrupt:
    print("stopped")
""",
    "in an import that is tried": """
sys.path.insert(0, sys.argv[1])
try:
    try:
        import slow
    except BaseException as error:
        print("torn", type(error))
    wait()
except KeyboardInterrupt:
    print("stopped" if slow.whole else "half")
""",
    "in an import, before a camera of pylon's emulation that grabs": """
sys.path.insert(0, sys.argv[1])
from pypylon import pylon
os.environ["PYLON_CAMEMU"] = "1"
camera = pylon.InstantCamera(pylon.TlFactory.GetInstance().CreateFirstDevice())
camera.Open()
camera.StartGrabbing()
import slow
try:
    wait()
except KeyboardInterrupt:
    print("stopped" if camera.IsGrabbing() else "idle")
camera.StopGrabbing()
camera.Close()
""",
    "while all is closed": """
try:
    with interrupts.held_back():
        with interrupts.held_back():
            hit(signal.SIGHUP)
            closed = "stopped"
    wait()
except KeyboardInterrupt:
    print(closed)
""",
    "in a device's closing that does not end": """
interrupts.CLOSING_S = 0.05
try:
    with interrupts.held_back():
        hit()
        time.sleep(0.1)
        hit()
        wait()
except KeyboardInterrupt:
    print("stopped")
""",
    "twice, while all is closed": """
try:
    hit()
    wait()
except KeyboardInterrupt:
    hit()
    hit(signal.SIGTERM)
    time.sleep(0.1)
    print("stopped")
""",
}


@pytest.mark.whole_after(2)
@pytest.mark.parametrize("moment", MOMENTS)
def test_an_interruption_stops_the_work_once(moment: str, tmp_path: Path) -> None:
    (tmp_path / "slow.py").write_text(
        "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\n"
        "for _ in range(20): time.sleep(0.01)\nwhole = True\n",
        encoding="utf-8",
    )
    command = [sys.executable, "-c", BEGIN + MOMENTS[moment], str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert (done.stdout, done.stderr) == ("stopped\n", "")


@pytest.mark.whole
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_at_the_end_of_the_process(number: signal.Signals) -> None:
    code = f"{BEGIN}\nimport atexit\natexit.register(lambda: (print('end', flush=True), time.sleep(20)))\n"
    with subprocess.Popen(
        [sys.executable, "-c", code + "interrupts.end_on_next_signal()"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "end\n"
        start = time.monotonic()
        process.send_signal(number)
        _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (130, "")
    assert time.monotonic() - start < 10
