"""Acts that cannot be undone or may harm a device: they need consent, of a person or by an option.

`--allow ACT` gives it in advance, for this process. Without it a person at the terminal is asked; where
nobody is there, the act is refused.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from enum import StrEnum

_allowed: set[DangerousAct] = set()


class DangerousAct(StrEnum):
    """What needs consent."""

    ERASE_FLASH = "erase-flash"
    """Sectors of a projector's flash memory are erased and written."""
    LED_CURRENT = "led-current"
    """An LED gets more current than its limit."""
    BEYOND_SOFT_LIMITS = "beyond-soft-limits"
    """A stage moves beyond the soft limits of the rig file."""


def allow_acts(acts: Iterable[DangerousAct]) -> None:
    """Consent to acts in advance, and to no others."""
    _allowed.clear()
    _allowed.update(acts)


def somebody_can_agree(act: DangerousAct) -> bool:
    """Tell whether an act is allowed already, or a person could be asked."""
    return act in _allowed or _has_terminal()


def agreed(act: DangerousAct, what: str) -> bool:
    """Ask whether to do what cannot be undone, unless that was allowed in advance."""
    if act in _allowed:
        return True
    if not _has_terminal():
        return False
    sys.stderr.write(f"{what} Go on? [y/N] ")
    sys.stderr.flush()
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def consent_words(act: DangerousAct) -> str:
    """Say how consent is given."""
    return f"agree to it at a terminal, or add --allow {act.value}"


def _has_terminal() -> bool:
    return sys.stdin is not None and sys.stdin.isatty()
