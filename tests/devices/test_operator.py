"""A person as a fixture, at the other end of a pseudo-terminal."""

import io
import os
import sys
from pathlib import Path

import pytest

from fpplab.core.errors import DeviceError
from fpplab.devices.operator import Operator


def test_a_person_is_asked_for_item_and_pose(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    hand, terminal = os.openpty()
    with open(terminal, encoding="utf-8") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        os.write(hand, b"\n\n\n")
        with Operator("fixture", {}) as operator:
            operator.mount("board", 2)
            operator.mount("pyramid")
            assert operator.pose("pyramid") is None
            operator.instruct("board", "in the middle of the image", Path("next_pose.png"))
    os.close(hand)
    asked = capsys.readouterr().err
    assert "Put board in front of the rig, as pose 2" in asked
    assert "Put pyramid" in asked
    assert "Hold board in the middle of the image (see next_pose.png), then press Enter" in asked


def test_without_a_terminal_there_is_nobody_to_ask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    with pytest.raises(DeviceError, match="nobody at the terminal; run this command in a terminal"):
        Operator("fixture", {}).open()
