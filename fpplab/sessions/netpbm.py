"""PGM and PPM files, with their levels as stored: other readers scale them to 8 or 16 bits."""

import re
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Image, full_scale
from fpplab.sessions.channels import WAY_OUT, NotGreyError, grey_from_channels
from fpplab.sessions.grey_depth import BIT_DEPTHS

_SPACE = rb"(?:\s|#[^\r\n]*[\r\n])+"
_HEAD = re.compile(rb"P([2356])%b(\d{1,7})%b(\d{1,7})%b(\d{1,5})(?:#[^\r\n]*[\r\n])*\s" % ((_SPACE,) * 3))
_OTHERS = {
    b"P1": "1-bit pixels (PBM)",
    b"P4": "1-bit pixels (PBM)",
    b"P7": "a PAM picture",
    b"Pf": "floating-point numbers (PFM)",
    b"PF": "floating-point numbers (PFM)",
}


def is_netpbm(head: bytes) -> bool:
    return re.match(rb"P[1-7fF]\s", head) is not None


class NetpbmFile:
    """One image in a PGM or PPM file."""

    pages, is_lossy = 1, False

    def __init__(self, stream: IO[bytes]) -> None:
        self._content = stream.read()
        if (other := _OTHERS.get(self._content[:2])) is not None:
            raise NotGreyError(f"holds {other}; {WAY_OUT}")
        head = _HEAD.match(self._content)
        if head is None:
            raise ValueError("its head lacks the width, the height or the greatest level")
        self._kind, width, height, self._max_level = map(int, head.groups())
        self._size, self._start = (width, height), head.end()
        if not (width and height and 0 < self._max_level < 1 << 16):
            raise ValueError(f"its head says {width} x {height} pixels of levels up to {self._max_level}")

    def size(self, page: int) -> tuple[int, int]:
        return self._size

    def stated_bits(self, page: int) -> int | None:
        """Depth by the greatest level that the head allows; one of 16 bits does not tell the camera's."""
        return {full_scale(bits): bits for bits in BIT_DEPTHS[1:-1]}.get(self._max_level)

    def read(self, page: int) -> Image:
        channels = 3 if self._kind in (3, 6) else 1
        count = self._size[0] * self._size[1] * channels
        levels = self._text_levels() if self._kind < 4 else self._binary_levels(count)
        if len(levels) != count:
            raise ValueError(f"{count} levels are expected and {len(levels)} are there")
        if (greatest := int(levels.max())) > self._max_level:
            raise ValueError(f"it has a level of {greatest}, and its head says {self._max_level} at most")
        stored = levels.astype(np.uint8 if self._max_level < 256 else np.uint16)
        return grey_from_channels(stored.reshape(self._size[1], self._size[0], channels))

    def _text_levels(self) -> NDArray[Any]:
        text = re.sub(rb"#[^\r\n]*", b"", self._content[self._start :])
        if re.search(rb"[^\d\s]", text):
            raise ValueError("its levels are not whole numbers")
        return np.array(text.split()).astype(np.int64)

    def _binary_levels(self, count: int) -> NDArray[Any]:
        dtype = np.dtype("u1" if self._max_level < 256 else ">u2")
        remaining = len(self._content) - self._start - count * dtype.itemsize
        if remaining < 0 or self._content[len(self._content) - remaining :].strip():
            more_or_fewer = "fewer" if remaining < 0 else "more"
            raise ValueError(f"bytes {more_or_fewer} than its head says: {abs(remaining)}")
        return np.frombuffer(self._content, dtype, count, self._start)
