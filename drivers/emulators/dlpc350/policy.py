"""Assumptions about undocumented behaviour of the board's firmware, as switches.

The emulator does what the maker's client, GUI and SDK show. Where they are silent, or only one user has
reported something, it follows a policy that can be changed here. Drivers are tested against each setting,
and no test claims that a board behaves so.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Dlpc350Policy:
    """Assumptions about the firmware.

    Attributes
    ----------
    echoes_sequence : bool
        A reply carries the sequence number of its request, as that of a DLPC900 does; otherwise 0.
    acknowledges_with_command : bool
        The reply to a write carries the number of its command, as clients written for the board expect;
        otherwise it is empty.
    answers_other_destinations : bool
        A message for another destination than the projector's control is refused; otherwise it is ignored.
    refuses_changes_while_running : bool
        Settings and tables cannot be changed while a sequence runs or is paused; otherwise they can.
    needs_validation : bool
        A start after changes that were not validated leaves the sequencer stopped and sets the abort flag.
    validation_s : float
        Time in s that a validation takes; until then its status reads busy, and a start is ignored.
    ignored_starts : int
        How many orders to start are acknowledged without effect, after each change of a sequence.
    running_shown_late_s : float
        How long after a start the main status still reads "stopped", in s.
    turnaround_s : float
        Time in s from a request to its reply, in which the sequencer goes on.
    accepts_a_gap_of_230_us : bool
        Whether a period of exactly 230 µs more than its exposure is valid.
    needs_lock_before_pattern_mode : bool
        Patterns from the video port run only if its signal was locked when pattern mode was ordered.
    swap_letter_is_input : bool
        In a channel swap such as "CAB", letter k names the input that goes to channel k; otherwise the
        channel that input k goes to. The board's own setting is the same either way.
    mode_change_s : float
        Time in s that a change of the display mode takes.
    wake_s : float
        Time in s that the controller takes to leave standby.
    loses_wake_acknowledgement : bool
        The order to wake is not acknowledged.
    sleeps_in_pattern_mode : bool
        Standby is accepted in pattern mode; otherwise only in video mode.
    reset_s : float
        Time in s that the USB device is absent after a software reset.
    keeps_last_pattern : bool
        A sequence that is stopped, or has ended, leaves its last pattern on the mirrors.
    image_load_s : float
        Time in s that loading an image from flash takes.
    sector_erase_s : float
        Time in s that the boot loader is busy erasing a sector.
    checksum_s : float
        Time in s that the boot loader is busy computing a checksum.
    protects_boot_sector : bool
        The boot loader refuses to erase or write its own sector.
    max_loader_data : int
        Bytes that the boot loader accepts in one data message. The maker's client never sends more because of
        a fault of the loader that it does not describe.
    """

    echoes_sequence: bool = True
    acknowledges_with_command: bool = True
    answers_other_destinations: bool = False
    refuses_changes_while_running: bool = True
    needs_validation: bool = True
    validation_s: float = 0.03
    ignored_starts: int = 0
    running_shown_late_s: float = 0.0
    turnaround_s: float = 0.0
    accepts_a_gap_of_230_us: bool = False
    needs_lock_before_pattern_mode: bool = True
    swap_letter_is_input: bool = True
    mode_change_s: float = 0.2
    wake_s: float = 2.0
    loses_wake_acknowledgement: bool = False
    sleeps_in_pattern_mode: bool = True
    reset_s: float = 2.0
    keeps_last_pattern: bool = True
    image_load_s: float = 0.02
    sector_erase_s: float = 0.8
    checksum_s: float = 0.001
    protects_boot_sector: bool = True
    max_loader_data: int = 504


STRICT = Dlpc350Policy(ignored_starts=1, running_shown_late_s=0.1, turnaround_s=0.002)
"""The harsher case wherever no source tells which one is right: tests and the emulated bench use it.

The first start after each change of a sequence has no effect, "running" is shown late, and every request
takes the time of two reports at full speed USB.
"""
