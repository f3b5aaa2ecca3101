"""What nobody knows of the board's firmware, as switches.

The emulator does what the maker's client, GUI and SDK show. Where they are silent, or only one user has
reported something, it follows a policy that can be changed here, so that a test never claims that a board
behaves so.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Dlpc350Policy:
    """Assumptions about the firmware.

    echoes_sequence: a reply bears the number of its request, as the DLPC900's does; otherwise 0.
    answers_other_destinations: what is not for the projector's control is refused; otherwise ignored.
    refuses_changes_while_running: settings and tables of a running or paused sequence; otherwise taken.
    needs_validation: a start after unvalidated changes leaves it stopped and sets the abort flag.
    validation_polls: how often a validation reads busy before it gives its answer.
    accepts_a_gap_of_230_us: of a period over its exposure, exactly.
    needs_lock_before_pattern_mode: patterns from the video port run only if its signal was locked when
    pattern mode was ordered.
    swap_names_the_input: of a channel swap's letters the k-th is the input that goes to channel k; otherwise
    the channel that input k goes to. The board's own setting is the same either way.
    mode_change_s: how long the display mode takes to change.
    wake_s: how long the controller takes to leave standby.
    loses_wake_acknowledgement: that of the order to wake is not sent.
    sleeps_in_pattern_mode: standby is accepted there; otherwise only in video mode.
    reset_s: how long the USB device stays away after a software reset.
    keeps_the_last_pattern: a sequence that is stopped, or at its end, leaves its pattern on the mirrors.
    image_load_s: how long a flash image takes to load.
    sector_erase_s: how long the boot loader is busy with a sector. checksum_s: and with a checksum.
    protects_boot_sector: the loader refuses to erase or write itself.
    most_loader_data: bytes of a data message that the loader takes; the maker's client never sends more for a
    fault of the loader that it does not describe.
    """

    echoes_sequence: bool = True
    answers_other_destinations: bool = False
    refuses_changes_while_running: bool = True
    needs_validation: bool = True
    validation_polls: int = 3
    accepts_a_gap_of_230_us: bool = False
    needs_lock_before_pattern_mode: bool = True
    swap_names_the_input: bool = True
    mode_change_s: float = 0.2
    wake_s: float = 2.0
    loses_wake_acknowledgement: bool = False
    sleeps_in_pattern_mode: bool = False
    reset_s: float = 2.0
    keeps_the_last_pattern: bool = True
    image_load_s: float = 0.02
    sector_erase_s: float = 0.8
    checksum_s: float = 0.001
    protects_boot_sector: bool = True
    most_loader_data: int = 504
