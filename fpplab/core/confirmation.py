"""Confirmation, by `--allow` or at the terminal, of what cannot be undone or may harm a device."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from enum import StrEnum

_confirmed: set[ConfirmationRequired] = set()


class ConfirmationRequired(StrEnum):
    """Operations that need confirmation."""

    ERASE_FLASH = "erase-flash"  # sectors of a projector's flash memory are erased and written
    LED_CURRENT = "led-current"  # an LED gets more current than its limit
    BEYOND_SOFT_LIMITS = "beyond-soft-limits"  # a stage moves beyond the soft limits of the rig file


def confirm_in_advance(operations: Iterable[ConfirmationRequired]) -> None:
    _confirmed.clear()
    _confirmed.update(operations)


def confirmed_in_advance() -> frozenset[ConfirmationRequired]:
    return frozenset(_confirmed)


def can_confirm(operation: ConfirmationRequired) -> bool:
    return operation in _confirmed or _has_terminal()


def confirm(operation: ConfirmationRequired, consequence: str) -> bool:
    if operation in _confirmed:
        return True
    if not _has_terminal():
        return False
    sys.stderr.write(f"{consequence} Go on? [y/N] ")
    sys.stderr.flush()
    return sys.stdin.readline().strip().lower() in ("y", "yes")


def how_to_confirm(operation: ConfirmationRequired) -> str:
    return f"confirm it at a terminal, or add --allow {operation.value}"


def _has_terminal() -> bool:
    return sys.stdin is not None and sys.stdin.isatty()
