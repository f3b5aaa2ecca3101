"""Registers of the emulated controller: their power-on values, and when they may be read and changed."""

from __future__ import annotations

from drivers.dlp4500 import protocol
from drivers.dlp4500.layout import Command, RegisterLayout, Values
from drivers.dlp4500.protocol import COMMANDS, Source, TriggerMode

SEQUENCE_COMMANDS = {
    command.number
    for command in (
        protocol.PATTERN_SOURCE,
        protocol.TRIGGER_MODE,
        protocol.EXPOSURE,
        protocol.INVERT,
        protocol.PATTERN_CONFIG,
        protocol.VARIABLE_CONFIG,
        protocol.TRIGGER_OUT_1,
        protocol.TRIGGER_OUT_2,
        protocol.TRIGGER_IN_1,
        protocol.MAILBOX,
        protocol.MAILBOX_ADDRESS,
        protocol.MAILBOX_DATA,
        protocol.VARIABLE_ADDRESS,
        protocol.VARIABLE_DATA,
    )
}
"""Not to be changed while a sequence runs; changing any of them invalidates an earlier validation."""
ANSWERED_ASLEEP = {
    command.number
    for command in (
        protocol.HARDWARE_STATUS,
        protocol.SYSTEM_STATUS,
        protocol.MAIN_STATUS,
        protocol.VERSION,
        protocol.FIRMWARE_TAG,
        protocol.POWER,
        protocol.SOFTWARE_RESET,
    )
}
"""Commands that a controller in standby still executes."""
FIRMWARE = {"major": 4, "minor": 4, "patch": 0}
"""Version of application, API and sequencer software that the emulator reports."""
TAG = b"LCr4500 emulator"  # answer to the command for the firmware's tag
POWER_ON: dict[Command, Values] = {
    protocol.INPUT_SOURCE: {"source": 0, "width": 1},
    protocol.CHANNEL_SWAP: {"swap": 4, "port": 0},
    protocol.TRIGGER_OUT_1: {"inverted": 0, "rising": 0xBB, "falling": 0xBB},
    protocol.TRIGGER_OUT_2: {"inverted": 0, "rising": 0xBB},
    protocol.LED_CURRENT: {"red": 0x97, "green": 0x78, "blue": 0x7D},
    protocol.LED_ENABLE: {"red": 0, "green": 0, "blue": 0, "sequenced": 1},
    protocol.EXPOSURE: {"exposure_us": 500_000, "period_us": 500_000},
    protocol.PATTERN_SOURCE: {"source": Source.FLASH},
    protocol.TRIGGER_MODE: {"mode": TriggerMode.INTERNAL},
    protocol.PATTERN_CONFIG: {"entries": 3, "repeat": 1, "patterns": 3, "images": 1},
}
"""Start values of the board's configuration; a register not named here has the lowest value of each field."""


def power_on() -> dict[int, Values]:
    registers = {}
    for command in COMMANDS.values():
        if isinstance(command.written, RegisterLayout) and command.written == command.returned:
            lowest = {field.name: field.values()[0] for field in command.written.named}
            registers[command.number] = POWER_ON.get(command, lowest)
    return registers
