"""Lengths with a unit, as options of commands state them, and sizes as a person reads them."""

from __future__ import annotations

import math
import re

from fpplab.core.errors import ConfigError

MM = {"nm": 1e-6, "um": 1e-3, "µm": 1e-3, "μm": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1000.0}
"""Units of length in mm; the micro sign and the Greek letter are both written."""


def length_mm(text: str, option: str) -> float:
    """Read a positive length with its unit."""
    match = re.fullmatch(r"\s*([0-9.eE+-]+)\s*([^\W\d]*)\s*", text)
    units = "um, mm, cm or m"
    if match is None:
        raise ConfigError(f"{option} is '{text}': must be a length with its unit ({units}), such as 20um")
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


def readable_bytes(count: int) -> str:
    """Write a number of bytes as a person reads it."""
    for unit, size in (("PB", 10**15), ("TB", 10**12), ("GB", 10**9), ("MB", 10**6), ("kB", 10**3)):
        if count >= 0.9995 * size:
            return f"{count / size:#.3g} {unit}".replace(". ", " ")
    return f"{count} bytes"
