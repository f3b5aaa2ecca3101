"""Numbers as a page shows them."""

from __future__ import annotations

NOT_KNOWN = "–"
"""Shown where a figure is not known."""


def number_words(value: float | None) -> str:
    """Write a figure with three significant digits.

    Parameters
    ----------
    value : float or None
        The figure.

    Returns
    -------
    str
        `NOT_KNOWN` for None; without decimals from 1000 on.
    """
    if value is None:
        return NOT_KNOWN
    return f"{value:.3g}" if abs(value) < 1000 else count_words(round(value))


def count_words(value: int) -> str:
    """Write a whole number, its thousands apart.

    Parameters
    ----------
    value : int
        The number.

    Returns
    -------
    str
        With narrow spaces that do not break.
    """
    return f"{value:,}".replace(",", "\u202f")


def percent_words(share: float) -> str:
    """Write a share in per cent.

    Parameters
    ----------
    share : float
        0 … 1.

    Returns
    -------
    str
        With three significant digits.
    """
    return f"{100 * share:.3g}\u202f%"
