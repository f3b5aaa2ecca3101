"""Numbers as a page shows them."""

NOT_KNOWN = "–"  # shown where a figure is not known


def number_text(value: float | None) -> str:
    if value is None:
        return NOT_KNOWN
    return f"{value:.3g}" if abs(value) < 1000 else count_text(round(value))


def count_text(value: int) -> str:
    return f"{value:,}".replace(",", "\u202f")


def percent_text(share: float) -> str:
    return f"{100 * share:.3g}\u202f%"
