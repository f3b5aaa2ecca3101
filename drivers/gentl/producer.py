"""GenTL producers and their cameras through `harvesters`; an emulated bench substitutes its own.

Producers differ in what they report: a serial number, a time stamp, when a camera is unplugged. What is not
reported is None here.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from threading import current_thread, main_thread
from typing import Any

import numpy as np
from genicam import gentl
from harvesters.core import Callback, Harvester
from harvesters.util.pfnc import dict_by_ints

from drivers.genicam.buffers import SPARE_BUFFERS
from drivers.genicam.pixels import image_from
from drivers.gentl.nodes import GentlNodeMap
from fpplab.core.conventions import Image
from fpplab.core.errors import ConfigError

FIRST_FRAME = {"U3V": 0, "GEV": 1}
"""Number of the first frame after a start, by the transport layer; that of other layers is not fixed."""


@dataclass(frozen=True, eq=False)
class GentlFrame:
    """One frame as the producer delivers it."""

    image: Image  # the pixels, a copy
    number: int  # the camera's own count
    time_s: float | None  # by the camera's clock, in s; None where it has none


class GentlProducer:
    """A loaded GenTL producer."""

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise ConfigError(f"{path}: there is no such GenTL producer; it comes with the maker's software")
        _try_to_load(path)
        self._harvester = Harvester()
        self._harvester.add_file(str(path))

    def cameras(self) -> dict[str, Any]:
        self._harvester.update()
        return {
            reported_property(info, "serial_number") or info.id_: info
            for info in self._harvester.device_info_list
        }

    def attach(self, info: Any) -> GentlEnd:
        with _ctrl_c_restored():
            return GentlEnd(self._harvester.create({"id_": info.id_}), info)

    def close(self) -> None:
        self._harvester.reset()


class IncompleteBufferError(Exception):
    """Data of a frame were lost on the way."""


class IncompleteBuffers(Callback):  # type: ignore[misc] # harvesters has no types
    """Called by harvesters, which itself only logs that it dropped an incomplete buffer."""

    def __init__(self) -> None:
        super().__init__()
        self._any = False

    def emit(self, context: Any) -> None:
        self._any = True

    def forgotten(self) -> bool:
        """Tell whether there was one since the last call."""
        was, self._any = self._any, False
        return was


class GentlEnd:
    """An open camera."""

    def __init__(self, acquirer: Any, info: Any) -> None:
        self._acquirer, self._incomplete = acquirer, IncompleteBuffers()
        acquirer.add_callback(acquirer.Events.INCOMPLETE_BUFFER, self._incomplete)
        self.model = " ".join(
            filter(None, (reported_property(info, "vendor"), reported_property(info, "model")))
        )
        self.vendor = reported_property(info, "vendor")
        self.link = f"GenTL {reported_property(info, 'tl_type')}"
        self.first_number = FIRST_FRAME.get(reported_property(info, "tl_type"))

    def GetNodeMap(self) -> GentlNodeMap:
        return GentlNodeMap(self._acquirer.remote_device.node_map)

    def start(self, frames: int) -> None:
        self._acquirer.num_buffers = frames + SPARE_BUFFERS
        self._incomplete.forgotten()
        self._acquirer.start()

    def fetch(self, timeout_s: float) -> GentlFrame | None:
        """Wait for the next frame; raise `IncompleteBufferError` as soon as one comes incomplete."""
        # Its `fetch` would drop an incomplete buffer, and wait for the next one for as long again.
        buffer = self._acquirer.try_fetch(timeout=max(timeout_s, 1e-3), is_raw=True)
        if buffer is None:
            if self._incomplete.forgotten():
                raise IncompleteBufferError
            return None
        with _returned(buffer):
            return GentlFrame(self._image(buffer), buffer.frame_id, _time_s(buffer))

    def _image(self, buffer: Any) -> Image:
        """Decode a buffer here: harvesters keeps the padding of rows, and unpacks across it."""
        nodes = self._acquirer.remote_device.node_map
        height = _from_buffer(lambda: buffer.height, lambda: nodes.Height.value)
        width = _from_buffer(lambda: buffer.width, lambda: nodes.Width.value)
        number = _from_buffer(lambda: buffer.pixel_format, lambda: int(nodes.PixelFormat.get_int_value()))
        padding = _from_buffer(lambda: buffer.padding_x, lambda: 0)
        offset = _from_buffer(lambda: buffer.image_offset, lambda: 0)
        raw = np.frombuffer(buffer.raw_buffer, np.uint8)[offset:]
        return image_from(raw, dict_by_ints.get(number, f"{number:#x}"), height, width, padding)

    def stop(self) -> None:
        """End the transfer, and drop the frames that wait."""
        self._acquirer.stop()

    def close(self) -> None:
        self._acquirer.destroy()


def _try_to_load(path: Path) -> None:
    """Raise `ConfigError` for a file that is no producer; harvesters would only log it."""
    producer = gentl.GenTLProducer.create_producer()
    try:
        producer.open(str(path))
    except gentl.GenericException as error:
        raise ConfigError(f"{path}: cannot be loaded as a GenTL producer: {error}") from error
    producer.close()


@contextmanager
def _ctrl_c_restored() -> Iterator[None]:
    """Restore the handler of Ctrl-C, which harvesters replaces when it opens a camera."""
    handler = signal.getsignal(signal.SIGINT)
    try:
        yield
    finally:
        if current_thread() is main_thread():
            signal.signal(signal.SIGINT, handler)


@contextmanager
def _returned(buffer: Any) -> Iterator[None]:
    try:
        yield
    finally:
        buffer.parent.queue_buffer(buffer)


def _time_s(buffer: Any) -> float | None:
    with suppress(gentl.GenericException):
        return float(buffer.timestamp_ns) / 1e9 or None
    return None


def _from_buffer(of_buffer: Callable[[], int], otherwise: Callable[[], int]) -> int:
    """Read a property of a buffer from the producer, or else from the camera."""
    try:
        return int(of_buffer())
    except gentl.GenericException:
        return int(otherwise())


def reported_property(info: Any, name: str) -> str:
    """Return a property of a camera as its producer reports it; empty where it does not."""
    with suppress(gentl.GenericException, AttributeError):
        return str(getattr(info, name) or "")
    return ""
