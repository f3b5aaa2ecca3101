"""Pixels of frames whose rows are padded or packed, by themselves and as a GenTL producer hands them over."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from genicam import gentl
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.genicam.pixels import image_from
from drivers.gentl.producer import GentlEnd

FORMATS = {
    "Mono8": (8, 0x0108_0001),
    "Mono10": (10, 0x0110_0003),
    "Mono12": (12, 0x0110_0005),
    "Mono12p": (12, 0x010C_0047),
    "Mono16": (16, 0x0110_0007),
}
"""Bits, and PFNC's number."""


def packed(pixels: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Twelve bits after twelve bits, least significant first, written bit by bit."""
    bits = (pixels.reshape(-1, 1) >> np.arange(12)) & 1
    return np.packbits(bits.astype(np.uint8).reshape(-1), bitorder="little")


def row_bytes(row: NDArray[Any], pixel_format: str) -> bytes:
    if pixel_format == "Mono12p":
        return packed(row).tobytes()
    return row.astype(np.uint8 if pixel_format == "Mono8" else "<u2").tobytes()


def written(image: NDArray[Any], pixel_format: str, padding: int) -> NDArray[np.uint8]:
    """The bytes of a frame; padding is 0xA5, and so is what a buffer has behind the frame."""
    rows = [image.reshape(-1)] if not padding else list(image)
    data = b"".join(row_bytes(row, pixel_format) + b"\xa5" * padding for row in rows)
    return np.frombuffer(data + b"\xa5" * 7, np.uint8)


@st.composite
def frames(draw: st.DrawFn) -> tuple[NDArray[Any], str, int]:
    pixel_format, height = draw(st.sampled_from(sorted(FORMATS))), draw(st.integers(1, 5))
    width, padding = draw(st.integers(1, 9)), draw(st.integers(0, 5))
    random = np.random.default_rng(draw(st.integers(0, 1000)))
    return random.integers(0, 1 << FORMATS[pixel_format][0], (height, width)), pixel_format, padding


@given(frames())
def test_pixels_come_out_as_they_went_in(frame: tuple[NDArray[Any], str, int]) -> None:
    image, pixel_format, padding = frame
    raw = written(image, pixel_format, padding)
    found = image_from(raw, pixel_format, *image.shape, padding)
    same = image_from(raw, pixel_format.replace("Mono", "BayerGB"), *image.shape, padding)
    np.testing.assert_array_equal(found, same)
    assert found.dtype == (np.uint8 if pixel_format == "Mono8" else np.uint16)
    np.testing.assert_array_equal(found, image)
    assert not np.shares_memory(found, raw)


def test_too_few_bytes_and_formats_that_are_not_known_are_refused() -> None:
    for pixel_format in ("Mono8", "Mono12p"):
        with pytest.raises(ValueError, match="too few"):
            image_from(np.zeros(8, np.uint8), pixel_format, 3, 3, 0)
    with pytest.raises(ValueError, match="RGB8 are not known"):
        image_from(np.zeros(9, np.uint8), "RGB8", 3, 3, 0)


class Silent:
    """A producer's buffer that tells nothing but its bytes; what it should tell is given."""

    frame_id, timestamp_ns = 5, 0

    def __init__(self, raw: NDArray[np.uint8], **told: int) -> None:
        self.raw_buffer, self._told, self.queued = raw.tobytes(), told, 0
        self.parent = SimpleNamespace(queue_buffer=self._queue)

    def _queue(self, buffer: Silent) -> None:
        assert buffer is self
        self.queued += 1

    def __getattr__(self, name: str) -> int:
        if name not in self._told:
            raise gentl.NotAvailableException
        return self._told[name]


def end_with(*buffers: Silent | None, **nodes: int) -> GentlEnd:
    waiting = list(buffers)

    def fetch(timeout: float, is_raw: bool) -> Silent | None:
        assert is_raw
        return waiting.pop(0)

    def node(value: int) -> SimpleNamespace:
        return SimpleNamespace(value=value, get_int_value=lambda: value)

    remote = SimpleNamespace(node_map=SimpleNamespace(**{name: node(value) for name, value in nodes.items()}))
    acquirer = SimpleNamespace(
        try_fetch=fetch,
        remote_device=remote,
        Events=SimpleNamespace(INCOMPLETE_BUFFER=4),
        add_callback=lambda event, callback: None,
    )
    return GentlEnd(acquirer, SimpleNamespace())


@pytest.mark.parametrize("pixel_format", FORMATS)
@pytest.mark.parametrize("padding", [0, 1, 3, 4])
@pytest.mark.parametrize("tells", [True, False])
def test_a_producers_rows_are_read_without_their_padding(
    pixel_format: str, padding: int, tells: bool
) -> None:
    """harvesters itself keeps the padding, and unpacks packed pixels across it."""
    bits, number = FORMATS[pixel_format]
    image = np.random.default_rng(2).integers(0, 1 << bits, (5, 7))
    told = {"padding_x": padding} | (
        {"height": 5, "width": 7, "pixel_format": number, "image_offset": 2} if tells else {}
    )
    raw = written(image, pixel_format, padding)
    buffer = Silent(np.concatenate([np.zeros(2, np.uint8), raw]) if tells else raw, **told)
    frame = end_with(buffer, Height=5, Width=7, PixelFormat=number).fetch(1.0)
    assert frame is not None
    np.testing.assert_array_equal(frame.image, image)
    assert (frame.number, frame.time_s, buffer.queued) == (5, None, 1)


def test_no_buffer_is_no_frame() -> None:
    assert end_with(None).fetch(0.01) is None
