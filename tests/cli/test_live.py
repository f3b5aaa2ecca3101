"""`fpplab live`: its answer, its keys in a terminal, and what it refuses."""

import os
import pty
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from fpplab.cli import console
from fpplab.cli.commands.live import _clear_line, live_command
from fpplab.core.errors import ConfigError
from fpplab.devices.rig import Rig
from tests.setup.live.benches import rig_file
from tests.support.commands import ROOT, Command


@pytest.mark.whole
def test_it_answers_with_what_was_chosen(fpplab: Command, tmp_path: Path) -> None:
    rig = rig_file(tmp_path)
    out = tmp_path / "live.rrd"
    done = fpplab("live", "--rig", rig, "--frames", "10", "--out", out, "--json")
    assert done.code == 0, done.err
    answer = done.json
    assert answer["frames"] == 10
    assert (answer["exposure_s"], answer["gain_db"]) == (0.02, 0.0)
    assert answer["poses"] == []
    assert answer["out"] == str(out)
    assert out.stat().st_size > 1000
    again = fpplab("live", "--rig", rig, "--frames", "3", "--out", out)
    assert again.code == 2
    assert "--force" in again.err


def test_the_line_of_figures_needs_no_codes_of_a_terminal(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Older consoles of Windows would print them."""
    monkeypatch.setattr(console, "stderr", Console(force_terminal=True, width=20))
    _clear_line()
    assert capsys.readouterr().err == f"\r{19 * ' '}\r"


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"item": "board"}, "'fixture' is missing"),
        ({"target": "target_paper", "plan": "plan_paper"}, "need x and y"),
        ({"target": "target_paper", "plan": "plan_six_images"}, "guided"),
        ({"distance": 400.0}, "--calibration"),
        ({"calibration": Path("nowhere.yaml")}, "nowhere.yaml"),
        ({"out": Path("live.png")}, ".rrd"),
    ],
)
def test_wrong_input_is_refused_before_anything_is_opened(
    options: dict[str, Any], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = rig_file(tmp_path)
    text = rig.read_text(encoding="utf-8")
    rig.write_text(re.sub(r"(?m)^fixture:\n(  .*\n)+", "", text), encoding="utf-8")
    monkeypatch.setattr(Rig, "__enter__", lambda rig: pytest.fail("the rig was opened"))
    with pytest.raises(ConfigError, match=said):
        live_command(str(rig), view=False, frames=2, **options)


@pytest.fixture
def live(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """The command in a terminal, once it shows frames; and the terminal's other end."""
    ours, theirs = pty.openpty()
    words = ["live", "--rig", str(rig_file(tmp_path)), "--no-view", "--seconds", "120"]
    command = [sys.executable, "-m", "fpplab", *words]
    with subprocess.Popen(
        command, stdin=theirs, stderr=theirs, stdout=subprocess.PIPE, text=True, cwd=ROOT
    ) as program:
        os.close(theirs)
        seen, deadline = b"", time.monotonic() + 60
        while b"peak" not in seen and time.monotonic() < deadline:
            seen += os.read(ours, 4096)
        assert b"Keys:" in seen
        yield program, ours
        program.kill()
    os.close(ours)


@pytest.mark.whole
def test_a_key_ends_it(live: tuple[subprocess.Popen[str], int]) -> None:
    program, terminal = live
    os.write(terminal, b"q")
    out, _ = program.communicate(timeout=60)
    assert program.returncode == 0
    assert "exposure_s: 0.02" in out


@pytest.mark.whole
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_cancel_it(number: signal.Signals, live: tuple[subprocess.Popen[str], int]) -> None:
    program, _ = live
    program.send_signal(number)
    program.communicate(timeout=60)
    assert program.returncode == 130
