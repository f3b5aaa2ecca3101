"""`fpplab emulate`: an emulated device that other programs use."""

import json
import signal
import subprocess
import sys

import pytest

from drivers.stage_grbl import GrblStage
from tests.support.commands import ROOT, Command


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_a_stage_is_served_until_it_is_ended(ending: signal.Signals) -> None:
    command = [sys.executable, "-m", "fpplab", "emulate", "stage", "--json"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as served:
        try:
            check_served(served, ending)
        finally:
            served.kill()  # leaving `with` waits for it, whatever failed


def check_served(served: subprocess.Popen[bytes], ending: signal.Signals) -> None:
    assert served.stdout is not None
    port = json.loads(served.stdout.readline())["port"]
    with GrblStage("stage", {"port": port}) as stage:
        assert stage.info().model == "GRBL 1.1f"
        assert stage.position_mm == 0.0
    served.send_signal(ending)
    _, errors = served.communicate(timeout=30)
    assert served.returncode == 0, errors
    assert b"Traceback" not in errors


def test_an_unknown_emulator_is_refused(fpplab: Command) -> None:
    done = fpplab("emulate", "toaster")
    assert done.code == 2
    assert "there is no emulator 'toaster'; there are dlp4500, stage" in done.err
