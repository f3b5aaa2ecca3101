"""Assumptions about undocumented behaviour of the board's firmware, as switches.

The emulator does what the maker's client, GUI and SDK show. Where they are silent, or only one user has
reported something, it follows a policy that can be changed here. Drivers are tested against each setting,
and no test claims that a board behaves so.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Dlpc350Policy:
    """Assumptions about the firmware."""

    echoes_sequence: bool = True  # A reply carries the sequence number of its request
    acknowledges_with_command: bool = True  # the reply to a write carries the number of its command
    answers_other_destinations: bool = False
    refuses_changes_while_running: bool = True
    needs_validation: bool = True
    validation_s: float = 0.03  # time in s that a validation takes
    ignored_starts: int = 0  # how many orders to start are acknowledged without effect
    running_shown_late_s: float = 0.0  # how long after a start the main status still reads "stopped", in s
    turnaround_s: float = 0.0  # time in s from a request to its reply, in which the sequencer goes on
    accepts_a_gap_of_230_us: bool = False
    needs_lock_before_pattern_mode: bool = True
    swap_letter_is_input: bool = True  # in a channel swap such as "CAB"
    mode_change_s: float = 0.2  # time in s that a change of the display mode takes
    wake_s: float = 2.0  # time in s that the controller takes to leave standby
    loses_wake_acknowledgement: bool = False  # the order to wake is not acknowledged
    sleeps_in_pattern_mode: bool = True  # standby is accepted in pattern mode; otherwise only in video mode
    reset_s: float = 2.0  # time in s that the USB device is absent after a software reset
    keeps_last_pattern: bool = True  # A sequence that is stopped
    image_load_s: float = 0.02  # time in s that loading an image from flash takes
    sector_erase_s: float = 0.8  # time in s that the boot loader is busy erasing a sector
    checksum_s: float = 0.001  # time in s that the boot loader is busy computing a checksum
    protects_boot_sector: bool = True  # the boot loader refuses to erase or write its own sector
    max_loader_data: int = 504  # bytes that the boot loader accepts in one data message


STRICT = Dlpc350Policy(ignored_starts=1, running_shown_late_s=0.1, turnaround_s=0.002)
"""The stricter case wherever no source says which one is right: tests and the emulated bench use it.

The first start after each change of a sequence has no effect, "running" is shown late, and every request
takes the time of two reports at full speed USB.
"""
