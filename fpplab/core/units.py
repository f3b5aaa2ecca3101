"""Lengths with a unit, as options of commands state them, and sizes as a person reads them."""

import math
import re

from fpplab.core.errors import ConfigError

MM_PER_INCH = 25.4  # by definition
MM = {"nm": 1e-6, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0, "inch": MM_PER_INCH}
"""Units of length in mm; the micro sign and the Greek letter are both written."""


def length_mm(text: str, option: str) -> float:
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*([^\W\d]*)\s*", text)
    units = "um, mm, cm or m"
    if match is None:
        is_comma = re.fullmatch(r"\d+,\d+\s*[a-zµμ]*", text.strip())
        advice = f"write {text.strip().replace(',', '.')}" if is_comma else "such as 20um"
        raise ConfigError(f"{option} is '{text}': must be a length with its unit ({units}); {advice}")
    number, unit = match.groups()
    if not unit:
        raise ConfigError(f"{option} is '{text}': its unit is missing ({units}); write {text.strip()}um, say")
    if unit not in MM:
        raise ConfigError(f"{option} is '{text}': '{unit}' is no unit of length that is known ({units})")
    try:
        value = float(number) * MM[unit]
    except ValueError:
        raise ConfigError(f"{option} is '{text}': '{number}' is no number") from None
    if not (math.isfinite(value) and value > 0):
        raise ConfigError(f"{option} is '{text}': must be greater than 0")
    return value


SECONDS = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0}
_PLAIN_UNITS = ("°", "deg", "px", "Hz", "bit", "bits", "dB")
_NUMBER_AND_UNIT = re.compile(r"([-+]?[\d.]+(?:e[-+]?\d+)?)(?:/(\d+))?\s*([^\W\d]*|°|%)", re.IGNORECASE)


def corrected_number(text: str, unit: str) -> str | None:
    """Give the number, in a unit, that a text with a decimal comma or a unit of its own stands for."""
    comma = re.fullmatch(r"([-+]?\d+),(\d+)\s*(\S*)", text.strip())
    match = _NUMBER_AND_UNIT.fullmatch(f"{comma[1]}.{comma[2]}{comma[3]}" if comma else text.strip())
    if match is None:
        return None
    number, divisor, written = match.groups()
    try:
        value = float(number) / float(divisor or 1)
    except (ValueError, ZeroDivisionError):
        return None
    for units in (MM, SECONDS):
        if unit in units and written in units:
            return f"{value * units[written] / units[unit]:.10g}"
    return f"{value:.10g}" if not written or written in (unit, *_PLAIN_UNITS) else None


def readable_bytes(count: int) -> str:
    for unit, size in (("PB", 10**15), ("TB", 10**12), ("GB", 10**9), ("MB", 10**6), ("kB", 10**3)):
        if count >= 0.9995 * size:
            return f"{count / size:#.3g} {unit}".replace(". ", " ")
    return f"{count} bytes"
