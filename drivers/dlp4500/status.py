"""The controller's status bits in words."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.dlp4500.protocol import Values

HARDWARE_FAULTS = {
    "reset_controller_error": "overlapping resets of the mirrors",
    "forced_swap_error": "an image was not loaded in time and the one before it stayed",
    "sequencer_aborted": "the sequencer gave up on an error",
    "sequencer_error": "an error of the sequencer",
}
MAIN_WORDS = {
    "parked": ("mirrors parked", "mirrors not parked"),
    "running": ("sequence running", "sequence stopped"),
    "frozen": ("frame buffer frozen", "frame buffer free"),
    "gamma": ("gamma correction on", "gamma correction off"),
}
VALIDATION_ERRORS = {
    "exposure_invalid": "exposure or period is not valid",
    "pattern_invalid": "a pattern number or an image is not valid",
}
VALIDATION_WARNINGS = {
    "trigger_overlap": "trigger output 1 is asked to stay high over inserted black",
    "black_missing": "no black before an externally triggered pattern",
    "gap_too_short": "the period is less than 230 µs longer than the exposure",
}


@dataclass(frozen=True)
class Status:
    """Fields of the three status commands, as the protocol names them."""

    hardware: Values
    system: Values
    main: Values

    @property
    def faults(self) -> list[str]:
        """What is wrong, in words; nothing on a healthy projector."""
        found = [] if self.hardware["initialised"] else ["the controller did not initialise"]
        found += [words for name, words in HARDWARE_FAULTS.items() if self.hardware[name]]
        return found if self.system["memory_test_passed"] else [*found, "the memory test failed"]

    @property
    def words(self) -> list[str]:
        """What it is doing, then what is wrong."""
        return [words[0 if self.main[name] else 1] for name, words in MAIN_WORDS.items()] + self.faults


def validation_messages(validation: Values) -> list[str]:
    """What a finished validation has against a sequence, warnings included."""
    known = VALIDATION_ERRORS | VALIDATION_WARNINGS
    return [words for name, words in known.items() if validation[name]]
