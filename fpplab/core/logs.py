"""Which loggers are listened to, and how device traffic is logged on request."""

import logging

LOGGERS = ("fpplab", "drivers", "sim", "fpplab_drivers", "fpplab_sim")
"""Packages whose loggers are listened to; libraries keep what they say to themselves."""
_traffic = logging.getLogger("fpplab.traffic")
_state = {"traced": False}


def trace_devices(enabled: bool) -> None:
    _state["traced"] = enabled


def log_traffic(device: str, direction: str, data: bytes | str) -> None:
    if _state["traced"]:
        message = data.rstrip(b"\0").hex() if isinstance(data, bytes) else data
        _traffic.info(
            "%s %s: %s", direction, device, message, extra={"device": device, "sent": direction == "to"}
        )
