"""`fpplab live`: its answer, its keys in a terminal, and what it refuses."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from fpplab.cli.commands.live import live_command
from fpplab.core.errors import ConfigError
from fpplab.devices.rig import Rig
from tests.live.benches import rig_file
from tests.support.commands import ROOT, Command


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
        live_command(str(rig), viewer=False, frames=2, **options)


@pytest.mark.slow
@pytest.mark.parametrize(("typed", "code"), [("q", 0), ("\x03", 130)])
def test_keys_of_a_terminal(typed: str, code: int, tmp_path: Path) -> None:
    """`q` is a normal end; Ctrl-C is 130."""
    rig = rig_file(tmp_path)
    ours, theirs = pty.openpty()
    words = ["live", "--rig", str(rig), "--no-viewer", "--seconds", "120"]
    with subprocess.Popen(
        [sys.executable, "-m", "fpplab", *words],
        stdin=theirs, stdout=subprocess.PIPE, stderr=theirs, text=True, cwd=ROOT, start_new_session=True,
        preexec_fn=lambda: __import__("fcntl").ioctl(0, __import__("termios").TIOCSCTTY, 0),
    ) as live:  # fmt: skip
        os.close(theirs)
        seen = b""
        deadline = time.monotonic() + 60
        while b"peak" not in seen and time.monotonic() < deadline:
            seen += os.read(ours, 4096)
        assert b"Keys:" in seen
        os.write(ours, typed.encode())
        out, _ = live.communicate(timeout=60)
    os.close(ours)
    assert live.returncode == code, seen
    assert ("exposure_s: 0.02" in out) == (code == 0)


@pytest.mark.slow
def test_sigterm_leaves_nothing_behind(tmp_path: Path) -> None:
    rig = rig_file(tmp_path)
    words = ["live", "--rig", str(rig), "--no-viewer", "--seconds", "120"]
    with subprocess.Popen(
        [sys.executable, "-m", "fpplab", *words],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    ) as live:
        assert live.stderr is not None
        assert "http://127.0.0.1" in live.stderr.readline()
        live.send_signal(signal.SIGTERM)
        live.communicate(timeout=60)
    assert live.returncode == 130
