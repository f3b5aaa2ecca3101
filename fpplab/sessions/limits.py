"""Limits of sessions, each with where it comes from: derived, measured or chosen."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SessionLimits:
    """Limits of what is read into a session, and of what is written next to it."""

    max_attachment_bytes: int = 64 << 20
    """Greatest size of a file that is no session in a bug report. Chosen."""
    max_report_bytes: int = 1 << 30
    """Greatest size in bytes of what a bug report takes of a session; it is held in memory. Chosen."""
    max_waiting_frames: int = 4
    """Frames that may wait for the disk; beyond them a full queue blocks the caller. Chosen."""
    min_grey_levels: int = 64
    """Fewest grey levels whose distances tell how many bits were shifted or scaled to 16. Chosen."""
    max_axis_ratio: int = 4
    """A last axis this many times shorter than both others counts images or colours, not columns. Chosen."""
    max_names_shown: int = 5  # names that are listed in a message (chosen)


SESSION_LIMITS = SessionLimits()
