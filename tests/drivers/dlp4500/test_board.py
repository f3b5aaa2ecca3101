"""The LightCrafter's board apart from its sequences."""

from pathlib import Path

import pytest

from drivers.dlp4500 import Dlp4500
from drivers.emulators.dlpc350 import Dlpc350Policy
from fpplab.core.errors import (
    DisconnectedError,
    ProtocolError,
)
from fpplab.devices import State
from tests.drivers.projector_bench import Bench, grey_of, greys


def test_a_board_without_numbers_in_its_answers(tmp_path: Path) -> None:
    bench = Bench(greys(2), tmp_path, Dlpc350Policy(echoes_sequence=False))
    with pytest.raises(ProtocolError, match="checks_echo: false"):
        bench.projector().open()
    with bench.projector(checks_echo=False) as projector:
        projector.load(bench.patterns)
        projector.show(1)
        assert bench.grey() == 255


def test_status_in_words(bench: Bench, projector: Dlp4500) -> None:
    board = projector._board
    assert board.status().descriptions == [
        "mirrors not parked", "sequence stopped", "frame buffer free", "gamma correction off",
    ]  # fmt: skip
    projector.load(bench.patterns)
    projector.show(0)
    assert "sequence running" in board.status().descriptions


def test_standby_and_back(bench: Bench, projector: Dlp4500) -> None:
    board = projector._board
    projector.load(bench.patterns)
    projector.show(0)
    board.enter_standby()
    assert board.is_standby()
    assert bench.is_dark()
    board.wake()
    assert not board.is_standby()
    projector.show(0)
    assert bench.grey() == grey_of(bench.patterns[0])


def test_reset_and_reconnection(bench: Bench, projector: Dlp4500) -> None:
    projector.load(bench.patterns)
    projector.show(0)
    projector._board.reset()
    with pytest.raises(DisconnectedError, match="the USB device was unplugged"):
        projector.info()
    assert projector.state is State.FAULT
    with pytest.raises(DisconnectedError):
        projector.close()
    projector.open()
    projector.load(bench.patterns)
    projector.show(1)
    assert bench.grey() == grey_of(bench.patterns[1])
