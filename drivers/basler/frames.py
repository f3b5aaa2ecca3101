"""From pylon's buffers to arrays, without a copy where that is safe.

pylon does not fill a buffer again while its grab result lives, also when the camera has been stopped, closed
or destroyed since. An array that keeps the grab result alive therefore owns its pixels. Buffers are few, so
that not every frame can have one: where they run short the pixels are copied.
"""

from __future__ import annotations

from typing import Any, cast
from weakref import WeakSet

import numba
import numpy as np
from numpy.typing import NDArray
from pypylon import pylon

from fpplab.core.conventions import Image

POOL_BYTES = 1 << 30
"""Memory that buffers may take, unless so few would fit that nothing could flow."""
SPARE = 4
"""Buffers that always go round between camera and host, however many frames the owner keeps."""


class BufferPool:
    """Buffers for as many frames of `frame_bytes` as may wait for the host, and who holds them."""

    def __init__(self, waiting: int, frame_bytes: int) -> None:
        self.size = min(waiting + SPARE, max(2 * SPARE, POOL_BYTES // frame_bytes))
        self._lent: WeakSet[_Lease] = WeakSet()

    def image(self, result: Any) -> Image:
        """The pixels of a grab result [v, u], its receiver's alone: uint8, or uint16 beyond 8 bits."""
        if result.GetPixelType() == pylon.PixelType_Mono12p:
            packed = np.frombuffer(result.GetImageMemoryView(), np.uint8)
            return cast(Image, unpack12(packed, result.GetHeight(), result.GetWidth()))
        if len(self._lent) >= self.size - SPARE:
            return cast(Image, _view(result).copy())
        lease = _Lease(result)
        self._lent.add(lease)
        return cast(Image, np.asarray(lease))


class _Lease:
    """Keeps a grab result for as long as an array looks at its buffer."""

    def __init__(self, result: Any) -> None:
        self._view = _view(result)
        self._result = result
        self.__array_interface__ = self._view.__array_interface__


def _view(result: Any) -> NDArray[Any]:
    """The buffer as (height, width), valid while the grab result lives."""
    height, width = result.GetHeight(), result.GetWidth()
    dtype = np.dtype(np.uint8 if result.GetPixelType() == pylon.PixelType_Mono8 else np.uint16)
    pitch = width * dtype.itemsize + result.GetPaddingX()
    memory = result.GetImageMemoryView()
    return np.ndarray((height, width), dtype, memory, strides=(pitch, dtype.itemsize))


@numba.njit(cache=True, nogil=True)
def unpack12(packed: NDArray[np.uint8], height: int, width: int) -> NDArray[np.uint16]:
    """Pixels of 12 bits without gaps, least significant first (Mono12p of the GenICam PFNC), as uint16.

    packed: at least ceil(1.5 height width) bytes. Three bytes hold two pixels; a last one may stand alone.
    """
    out = np.empty(height * width, np.uint16)
    for pair in range(out.size // 2):
        low, middle, high = packed[3 * pair], packed[3 * pair + 1], packed[3 * pair + 2]
        out[2 * pair] = low + (middle & 0x0F) * 256
        out[2 * pair + 1] = (middle >> 4) + high * 16
    if out.size % 2:
        last = out.size // 2 * 3
        out[-1] = packed[last] + (packed[last + 1] & 0x0F) * 256
    return out.reshape(height, width)
