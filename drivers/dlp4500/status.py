"""Descriptions of the controller's status bits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from drivers.dlp4500.layout import Values

HARDWARE_FAULTS = {
    "reset_controller_error": "overlapping resets of the mirrors",
    "forced_swap_error": "an image was not loaded in time and an older one was shown",
    "sequencer_aborted": "the sequencer aborted on an error",
    "sequencer_error": "an error of the sequencer",
}
"""Faults by field of the hardware status."""
MAIN_STATES = {
    "parked": ("mirrors parked", "mirrors not parked"),
    "running": ("sequence running", "sequence stopped"),
    "frozen": ("frame buffer frozen", "frame buffer free"),
    "gamma": ("gamma correction on", "gamma correction off"),
}
"""Descriptions of the set and the cleared bit, by field of the main status."""
VALIDATION_ERRORS = {
    "exposure_invalid": "exposure or period is not valid",
    "pattern_invalid": "a pattern number or an image is not valid",
}
"""Reasons why a sequence cannot run, by field of the validation."""
VALIDATION_WARNINGS = {
    "trigger_overlap": "trigger output 1 would stay high during inserted black",
    "black_missing": "no black before an externally triggered pattern",
    "gap_too_short": "the period is less than 230 µs longer than the exposure",
}
"""Reasons why a sequence may not run as intended, by field of the validation."""


@dataclass(frozen=True)
class Status:
    """Replies to the three status commands."""

    hardware: Values  # fields of `protocol.HARDWARE_STATUS`
    system: Values  # fields of `protocol.SYSTEM_STATUS`
    main: Values  # fields of `protocol.MAIN_STATUS`

    @property
    def faults(self) -> list[str]:
        """Descriptions of all faults; empty for a healthy projector."""
        faults = [] if self.hardware["initialised"] else ["the controller did not initialise"]
        faults += hardware_faults(self.hardware)
        return faults if self.system["memory_test_passed"] else [*faults, "the memory test failed"]

    @property
    def descriptions(self) -> list[str]:
        """Descriptions of what the projector is doing, followed by its faults."""
        states = [texts[0 if self.main[name] else 1] for name, texts in MAIN_STATES.items()]
        return states + self.faults


def hardware_faults(hardware: Values) -> list[str]:
    return [description for name, description in HARDWARE_FAULTS.items() if hardware[name]]


def validation_messages(validation: Values, descriptions: Mapping[str, str]) -> list[str]:
    """Describe the errors that a finished validation reports."""
    return [description for name, description in descriptions.items() if validation[name]]
