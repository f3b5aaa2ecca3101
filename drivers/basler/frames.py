"""Conversion of pylon's buffers to arrays, without a copy where that is safe.

pylon does not fill a buffer again while its grab result exists, even after the camera was stopped, closed or
destroyed. An array that keeps the grab result alive therefore owns its pixels. The number of buffers is
limited: where they run short the pixels are copied instead.
"""

from typing import Any, cast
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray
from pypylon import pylon

from drivers.genicam import buffers
from drivers.genicam.pixels import unpack12
from fpplab.core.conventions import Image


class BufferPool:
    """Number of grab buffers, and which of them are in use by arrays."""

    def __init__(self, waiting: int, frame_bytes: int) -> None:
        self.size = min(waiting, buffers.held_frames(frame_bytes)) + buffers.SPARE_BUFFERS
        self._lent: WeakSet[_Lease] = WeakSet()

    def image(self, result: Any) -> Image:
        """Return the pixels of a grab result as an array that only the caller holds."""
        # The array uses pylon's buffer while enough buffers remain for the transfer; otherwise, and for
        # packed formats, it is a copy.
        # returns (height, width)
        if pylon.IsPacked(result.GetPixelType()):
            packed = np.frombuffer(result.GetImageMemoryView(), np.uint8)
            return unpack12(packed, result.GetHeight(), result.GetWidth(), result.GetPaddingX())
        if len(self._lent) >= self.size - buffers.SPARE_BUFFERS:
            return cast(Image, _view_buffer(result).copy())
        lease = _Lease(result)
        self._lent.add(lease)
        return cast(Image, np.asarray(lease))


class _Lease:
    """Keeps a grab result alive for as long as an array uses its buffer."""

    def __init__(self, result: Any) -> None:
        self._view = _view_buffer(result)
        self._result = result
        self.__array_interface__ = self._view.__array_interface__


def _view_buffer(result: Any) -> NDArray[Any]:
    """Return the buffer as an array (height, width), valid while the grab result exists."""
    height, width = result.GetHeight(), result.GetWidth()
    dtype = np.dtype(np.uint8 if pylon.BitPerPixel(result.GetPixelType()) == 8 else np.uint16)
    pitch = width * dtype.itemsize + result.GetPaddingX()
    memory = result.GetImageMemoryView()
    return np.ndarray((height, width), dtype, memory, strides=(pitch, dtype.itemsize))
