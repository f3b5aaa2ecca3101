"""What other programs, and sessions before, have left on the LightCrafter: its settings and its mode."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.dlp4500 import protocol
from drivers.dlp4500.board import WHOLE_AREA
from drivers.dlp4500.layout import Command
from drivers.dlp4500.protocol import DisplayMode
from drivers.dlp4500.transport import Link, connect
from drivers.emulators.dlpc350 import STRICT
from fpplab.core.errors import DeviceTimeoutError, StateError
from tests.drivers.projector_bench import Bench, VideoBench, greys

WRONG: tuple[tuple[Command, dict[str, int]], ...] = (
    (protocol.LONG_AXIS_FLIP, {"on": 1}),
    (protocol.SHORT_AXIS_FLIP, {"on": 1}),
    (protocol.FREEZE, {"on": 1}),
    (protocol.INVERT, {"on": 1}),
    (protocol.LED_POLARITY, {"inverted": 1}),
    *((delays, {"rising": 0xD5, "falling": 0}) for delays in protocol.LED_DELAYS.values()),
    (protocol.TRIGGER_OUT_1, {"inverted": 1, "rising": 0, "falling": 0xD5}),
    (protocol.TRIGGER_OUT_2, {"inverted": 1, "rising": 0}),
    (protocol.TRIGGER_IN_1, {"delay": 9_999}),
    (protocol.TRIGGER_IN_2, {"inverted": 1}),
    (protocol.GAMMA, {"table": 1, "on": 1}),
    (protocol.AREA, dict.fromkeys(WHOLE_AREA, 100)),
    (protocol.CHANNEL_SWAP, {"swap": 1, "port": 0}),
    (protocol.PIXEL_FORMAT, {"format": 1}),
    (protocol.PORT_CLOCK, {"clock": 2}),
    (protocol.LED_CURRENT, {"red": 0, "green": 0, "blue": 0}),
    (protocol.LED_ENABLE, {"red": 1, "green": 1, "blue": 1, "sequenced": 0}),
)


def left_by_another_program(bench: Bench, *wrong: tuple[Command, dict[str, int]]) -> None:
    """Send settings as another program would."""
    link = Link(connect(bench.hid, "other", None)[0], bench.clock, "other")
    for command, values in wrong:
        link.write(command, **values)
    link.close()


def shown(bench: Bench) -> list[Any]:
    """Everything of the light and the trigger with which each pattern is shown."""
    seen = []
    with bench.projector(led_levels={"red": 60, "green": 0, "blue": 255}) as projector:
        projector.load(bench.patterns)
        for i in range(len(bench.patterns)):
            projector.show(i)
            light = bench.controller.light()
            assert light is not None
            seen.append((dict(light.levels), np.unique(light.grey).tolist()))
        tables = bench.controller.sequencer.tables
        assert tables is not None
        seen.append((tables.edges_s, tables.input_delay_s, bench.controller.inverts_output_1))
        projector.blank()
        assert bench.is_dark()
    return seen


@pytest.mark.parametrize("kind", [Bench, VideoBench])
def test_settings_of_other_programs_do_not_alter_the_light(kind: type[Bench], tmp_path: Path) -> None:
    ordered = shown(kind(greys(3), tmp_path))
    bench = kind(greys(3), tmp_path)
    left_by_another_program(bench, *WRONG)
    assert shown(bench) == ordered


def test_settings_that_were_changed_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    bench = Bench(greys(1), tmp_path)
    left_by_another_program(bench, (protocol.LED_POLARITY, {"inverted": 1}))
    with caplog.at_level("INFO"), bench.projector():
        assert "projector: LED polarity was {'inverted': 1}, is set to {'inverted': 0}" in caplog.text


@pytest.mark.parametrize(
    "count", [15, pytest.param(1000, marks=[pytest.mark.nightly, pytest.mark.timeout(1800)])]
)
def test_sessions_over_the_video_port_do_not_freeze_the_board(count: int, tmp_path: Path) -> None:
    bench = VideoBench(greys(2), tmp_path)
    for _ in range(count):
        with bench.projector() as projector:
            projector.load(bench.patterns)
            projector.show(1)
            assert bench.grey() == 255
    assert not bench.controller.frozen


@pytest.mark.parametrize("seed", range(1, 4))
def test_the_emulated_board_freezes_as_reported(seed: int, tmp_path: Path) -> None:
    """Changes of mode with a signal do within 30 tries, until it is switched off; without a signal none."""
    bench = VideoBench(greys(1), tmp_path, replace(STRICT, freeze_seed=seed))
    link = Link(connect(bench.hid, "other", None)[0], bench.clock, "other")

    def change(times: int) -> None:
        for mode in (DisplayMode.PATTERN, DisplayMode.VIDEO) * times:
            link.write(protocol.DISPLAY_MODE, mode=mode)
            bench.clock.sleep(1.0)

    assert bench.controller.video is not None
    bench.controller.video.locked = False
    change(100)
    bench.controller.video.locked = True
    with pytest.raises(DeviceTimeoutError):
        change(30)
    with pytest.raises(DeviceTimeoutError):
        link.read(protocol.DISPLAY_MODE)
    bench.controller.restart()
    assert link.read(protocol.DISPLAY_MODE) == {"mode": DisplayMode.VIDEO}


def test_a_test_pattern_that_may_freeze_the_board_is_refused(tmp_path: Path) -> None:
    bench = VideoBench(greys(1), tmp_path)
    with bench.projector() as projector:
        with pytest.raises(StateError, match="unplug the HDMI cable"):
            projector._board.show_test_pattern("grid")
        assert bench.is_dark()
