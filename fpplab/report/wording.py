"""Numbers as a page shows them."""

import re

NOT_KNOWN = "–"  # shown where a figure is not known


def number_text(value: float | None) -> str:
    if value is None:
        return NOT_KNOWN
    return f"{value:.3g}" if abs(value) < 1000 else count_text(round(value))


def count_text(value: int) -> str:
    return f"{value:,}".replace(",", "\u202f")


def grouped(text: str) -> str:
    """A sentence with the digits of its counts from 10000 on in groups of three."""
    return re.sub(r"(?<![\w.:-])\d{5,}(?![\w.:-])", lambda found: count_text(int(found[0])), text)


def percent_text(share: float) -> str:
    return f"{100 * share:.3g}\u202f%"
