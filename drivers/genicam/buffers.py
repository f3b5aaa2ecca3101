"""Buffers that a computer keeps for a camera's frames."""

MAX_POOL_BYTES = 1 << 30
"""Memory limit of the buffers in bytes (chosen); exceeded only where fewer than the minimum would fit."""
SPARE_BUFFERS = 4
"""Buffers kept for the transfer from the camera, however many frames wait or are held (chosen)."""


def held_frames(frame_bytes: int) -> int:
    """Return how many frames may wait until they are read, beside the spare buffers."""
    return max(SPARE_BUFFERS, MAX_POOL_BYTES // frame_bytes - SPARE_BUFFERS)
