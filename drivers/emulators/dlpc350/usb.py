"""The emulated controller on an emulated wire that looks like hidapi, and what can go wrong on it."""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from enum import Enum, auto
from itertools import count
from typing import Any

from drivers.dlp4500.framing import REPORT_BYTES, UsbMessage, continuation_reports, join_reports, parse_header
from drivers.dlp4500.transport import INTERFACE, PRODUCT, VENDOR
from drivers.emulators.dlpc350.firmware import Dlpc350

LATE_S = 3.0


class UsbFault(Enum):
    """What becomes of one request or of its reply."""

    DROP = auto()
    """Done, but the reply is lost."""
    LATE = auto()
    """Done, and the reply comes after `LATE_S`."""
    DUPLICATE = auto()
    """Done, and the reply comes twice."""
    NACK = auto()
    """Not done, and said so."""
    SHORT = auto()
    """Done, and the reply's report is cut."""
    UNPLUG_BEFORE = auto()
    """Gone before it is done."""
    UNPLUG_AFTER = auto()
    """Done, and gone."""


class UnpluggedError(OSError):
    """What hidapi raises on reading from a device that is gone."""


class EmulatedHid:
    """Stands in for the module `hid`, with one projector plugged in.

    faults: by number of the request since the beginning. requests: how many there were.
    """

    def __init__(
        self, controller: Dlpc350, serial: str = "LCR3", faults: Mapping[int, UsbFault] | None = None
    ):
        self.controller, self.serial = controller, serial
        self.faults = dict(faults or {})
        self.requests = 0
        self.plugs = 1
        self._plugged_from_s: float | None = 0.0
        controller.on_restart = self.vanish

    @property
    def is_plugged(self) -> bool:
        """Whether it can be found."""
        return self._plugged_from_s is not None and self.controller.clock.now() >= self._plugged_from_s

    def unplug(self) -> None:
        """Take the USB cable out: the projector itself goes on."""
        self._plugged_from_s = None
        self.plugs += 1

    def plug(self) -> None:
        """Put it in again."""
        self._plugged_from_s = self.controller.clock.now()

    def vanish(self, seconds: float) -> None:
        """Leave the bus for a while, as in a reset."""
        self.unplug()
        self._plugged_from_s = self.controller.clock.now() + seconds

    def enumerate(self, vendor_id: int = 0, product_id: int = 0) -> list[dict[str, Any]]:
        """Both interfaces, the one without commands first."""
        if not self.is_plugged or (vendor_id, product_id) != (VENDOR, PRODUCT):
            return []
        return [
            {
                "path": f"emulated:{number}".encode(),
                "interface_number": number,
                "serial_number": self.serial,
                "product_string": "DLPC350",
            }
            for number in (INTERFACE + 1, INTERFACE)
        ]

    def device(self) -> EmulatedDevice:
        """As `hid.device()`."""
        return EmulatedDevice(self)


class EmulatedDevice:
    """Stands in for hidapi's `hid.device`: reports in, reports out."""

    def __init__(self, hid: EmulatedHid) -> None:
        self._hid, self._clock = hid, hid.controller.clock
        self._plug: int | None = None
        self._incoming: list[bytes] = []
        self._outgoing: list[tuple[float, int, bytes]] = []
        self._order = count()

    def open_path(self, path: bytes) -> None:
        """Open; `OSError` for what is not there."""
        if not self._hid.is_plugged or path != f"emulated:{INTERFACE}".encode():
            raise OSError("open failed")
        self._plug = self._hid.plugs

    def close(self) -> None:
        """Let go."""
        self._plug = None

    def write(self, buff: bytes) -> int:
        """Take a report number, 0, and a report; -1 when the device is gone."""
        if not self._is_alive():
            return -1
        if len(buff) != REPORT_BYTES + 1 or buff[0]:
            return -1
        self._take(bytes(buff[1:]))
        return len(buff)

    def read(self, max_length: int, timeout_ms: int = 0) -> list[int]:
        """The next report that comes in time, or nothing."""
        if timeout_ms <= 0:
            raise ValueError("hidapi would wait for ever")
        if not self._is_alive():
            raise UnpluggedError("read error")
        now = self._clock.now()
        deadline = now + 1e-3 * timeout_ms
        due = self._outgoing[0][0] if self._outgoing else float("inf")
        if due > deadline:
            self._clock.sleep(deadline - now)
            return []
        if due > now:
            self._clock.sleep(due - now)
        return list(heapq.heappop(self._outgoing)[2][:max_length])

    def has_report(self) -> bool:
        """Whether one can be read without waiting."""
        return self._is_alive() and bool(self._outgoing) and self._outgoing[0][0] <= self._clock.now()

    def _is_alive(self) -> bool:
        return self._plug == self._hid.plugs and self._hid.is_plugged

    def _take(self, report: bytes) -> None:
        """Collect reports until a message is whole."""
        self._incoming.append(report)
        try:
            length = parse_header(self._incoming[0]).length
        except ValueError:
            self._incoming = []  # longer than the buffer: nothing that could be answered
            return
        if len(self._incoming) == 1 + continuation_reports(length):
            message, self._incoming = join_reports(self._incoming), []
            self._serve(message)

    def _serve(self, message: UsbMessage) -> None:
        hid, controller = self._hid, self._hid.controller
        fault = hid.faults.get(hid.requests)
        hid.requests += 1
        if fault is UsbFault.UNPLUG_BEFORE:
            hid.unplug()
            return
        reply = controller.refusal(message) if fault is UsbFault.NACK else controller.answer(message)
        if fault is UsbFault.UNPLUG_AFTER:
            hid.unplug()
        elif reply is not None and fault is not UsbFault.DROP:
            self._send(reply, fault)

    def _send(self, reply: UsbMessage, fault: UsbFault | None) -> None:
        due = self._clock.now() + (LATE_S if fault is UsbFault.LATE else 0.0)
        for report in reply.reports() * (2 if fault is UsbFault.DUPLICATE else 1):
            sent = report[: REPORT_BYTES // 2] if fault is UsbFault.SHORT else report
            heapq.heappush(self._outgoing, (due, next(self._order), sent))
