"""`fpplab dlp4500 status|power|led|test-pattern` on an emulated projector."""

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import Result
from typer.testing import CliRunner

from drivers.clock import SteppedClock
from drivers.dlp4500 import Dlp4500, protocol
from drivers.emulators.dlpc350 import Dlpc350, Dlpc350Policy, EmulatedHid
from fpplab.cli.every import app
from fpplab.core import config, confirmation
from fpplab.core.errors import ConfigError, DisconnectedError, LimitError, ProtocolError
from tests.drivers.dlpc350_host import FLASH


@pytest.fixture
def hid(monkeypatch: pytest.MonkeyPatch) -> EmulatedHid:
    """One projector, in a time of its own."""
    found = EmulatedHid(Dlpc350(SteppedClock(), FLASH))
    monkeypatch.setattr("drivers.dlp4500.transport.load_hidapi", lambda name: found)
    monkeypatch.setattr("drivers.clock.RealClock", lambda: found.controller.clock)
    return found


def run(*words: str) -> Result:
    return CliRunner().invoke(app, ["dlp4500", *words, "--json"])


def said(*words: str) -> dict[str, Any]:
    result = run(*words)
    assert result.exit_code == 0, result.output
    found: dict[str, Any] = json.loads(result.stdout)
    return found


def test_status(hid: EmulatedHid) -> None:
    found = said("status")
    assert found == {
        "firmware": "4.4.0",
        "tag": "LCr4500 emulator",
        "standby": False,
        "images": 4,
        "state": ["mirrors not parked", "sequence stopped", "frame buffer free", "gamma correction off"],
        "faults": [],
    }


def test_a_board_that_does_not_echo(hid: EmulatedHid) -> None:
    hid.controller.policy = Dlpc350Policy(echoes_sequence=False)
    refused = run("status")
    assert isinstance(refused.exception, ProtocolError)
    assert "--no-echo" in str(refused.exception)
    assert said("status", "--no-echo")["firmware"] == "4.4.0"
    assert isinstance(run("led", "--green", "10").exception, ProtocolError)
    assert said("led", "--green", "10", "--no-echo")["green"] == 10


def test_status_of_one_that_sleeps(hid: EmulatedHid) -> None:
    hid.controller.asleep = True
    found = said("status")
    assert found["standby"] is True
    assert found["images"] is None
    assert found["state"][0] == "mirrors parked"


def test_power(hid: EmulatedHid) -> None:
    assert said("power", "off") == {"power": "off"}
    assert hid.controller.is_asleep()
    assert said("power", "on") == {"power": "on"}
    assert not hid.controller.is_asleep()
    assert hid.controller.light() is None
    assert said("power", "reset") == {"power": "reset"}
    assert hid.is_plugged, "the command ends when it can be opened again"
    assert said("status")["firmware"] == "4.4.0"


def test_leds_by_hand(hid: EmulatedHid) -> None:
    said("led", "--green", "51", "--blue", "255", "--allow", "led-current")
    light = hid.controller.light()
    assert light is not None
    assert light.levels == {"green": pytest.approx(0.2), "blue": 1.0}
    said("led", "--red", "255", "--not-inverted", "--allow", "led-current")
    assert hid.controller._registers[protocol.LED_CURRENT.number] == {"red": 255, "green": 0, "blue": 0}
    said("led")
    assert hid.controller.light() is None


@pytest.mark.whole
def test_levels_above_the_limits_need_consent(
    hid: EmulatedHid, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said("led")
    refused = run("led", "--green", "136", "--blue", "130")
    assert isinstance(refused.exception, LimitError)
    assert "green 136 (limit 135); confirm it at a terminal, or add --allow led-current" in str(
        refused.exception
    )
    assert hid.controller.light() is None
    assert said("led", "--green", "136", "--dry-run")["above_limits"] == ["green 136 (limit 135)"]
    assert hid.controller.light() is None
    rig = tmp_path / "rig.yaml"
    text = config.find_config("rig_bench.yaml").read_text(encoding="utf-8")
    rig.write_text(
        text.replace("flash: patterns.yaml}", "flash: patterns.yaml, led_limits: {green: 50}}"),
        encoding="utf-8",
    )
    assert said("led", "--green", "51", "--dry-run", "--rig", str(rig))["above_limits"]
    assert not said("led", "--green", "50", "--dry-run", "--rig", str(rig))["above_limits"]
    monkeypatch.setattr(confirmation, "_has_terminal", lambda: True)
    for answer, is_lit in (("n\n", False), ("y\n", True)):
        CliRunner().invoke(app, ["dlp4500", "led", "--green", "200"], input=answer)
        assert (hid.controller.light() is not None) is is_lit


def test_a_rig_file_whose_levels_exceed_its_limits_is_refused() -> None:
    options = {"video": {"display": 0}, "led_limits": {"green": 100}, "led_levels": {"green": 101}}
    with pytest.raises(ConfigError, match=r"'led_levels.green' is 101, but 'led_limits.green' is 100"):
        Dlp4500("projector", options)


@pytest.mark.whole
def test_test_patterns(hid: EmulatedHid) -> None:
    for number, name in enumerate(protocol.TEST_PATTERNS):
        said("test-pattern", name)
        assert hid.controller._registers[protocol.TEST_PATTERN.number] == {"pattern": number}
    assert hid.controller._registers[protocol.INPUT_SOURCE.number]["source"] == 1
    assert hid.controller.light() is not None
    said("test-pattern", "off")
    assert hid.controller.light() is None


def test_what_is_not_there(hid: EmulatedHid) -> None:
    assert isinstance(run("test-pattern", "cat").exception, ConfigError)
    assert isinstance(run("status", "--serial", "other").exception, DisconnectedError)
    hid.unplug()
    assert isinstance(run("power", "off").exception, DisconnectedError)
