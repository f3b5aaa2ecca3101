"""Limits of sessions, each with where it comes from: derived, measured or chosen."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SessionLimits:
    """Limits of what is read into a session, and of what is written next to it."""

    max_attachment_bytes: int = 64 << 20  # of a file that is no session in a bug report (chosen)
    max_report_bytes: int = 1 << 30  # of what a bug report takes of a session, held in memory (chosen)
    max_waiting_frames: int = 4  # for the disk; beyond them a full queue blocks the caller (chosen)
    min_grey_levels: int = 64  # whose distances tell how many bits were shifted or scaled to 16 (chosen)
    max_axis_ratio: int = 4  # a last axis so many times shorter counts images or colours (chosen)
    max_names_shown: int = 5  # names that are listed in a message (chosen)


SESSION_LIMITS = SessionLimits()
