"""Progress reports and observers: the one type of each, and their defaults that do nothing."""

from collections.abc import Callable

Progress = Callable[[float], None]
"""Called with the share of the work that is done, 0 … 1. What it raises ends the work."""

Say = Callable[[str], object]  # called with a sentence for the operator


def no_progress(share: float) -> None:
    """Report no progress; the default of every `progress` parameter."""


def ignore(*observed: object) -> None:
    """Ignore what is observed; the default of every `observe` parameter."""
