"""A headless Chromium, driven over its debugging pipe: opens a page, takes pictures, and logs its traffic."""

from __future__ import annotations

import base64
import io
import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

import numpy as np
from numpy.typing import NDArray
from PIL import Image as Pixels

PROGRAM = next((found for name in ("chromium", "chromium-browser") if (found := shutil.which(name))), None)
OPTIONS = (
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-default-apps",
    "--disable-features=AutofillServerCommunication,OptimizationHints",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=1600,1000",
    "--remote-debugging-pipe",
)

CAUSES = ("initiator", "network_isolation_key", "network_anonymization_key", "site_for_cookies")
"""What an event of the network log names as its cause."""
SAID = ("Runtime.consoleAPICalled", "Runtime.exceptionThrown", "Log.entryAdded")
"""Events in which the page says something."""

Picture = NDArray[np.uint8]


class Browser:
    """Chromium with a new profile in `folder`; what it loads is logged there."""

    def __init__(self, folder: Path) -> None:
        assert PROGRAM is not None
        self.log = folder / "net-log.json"
        self.words: list[str] = []
        self._number = 0
        self._buffer = b""
        ours, theirs = os.pipe(), os.pipe()

        def descriptors() -> None:  # the browser reads commands from 3 and answers on 4
            os.dup2(ours[0], 100)
            os.dup2(theirs[1], 101)
            os.dup2(100, 3)
            os.dup2(101, 4)

        self._process = subprocess.Popen(
            [PROGRAM, *OPTIONS, f"--user-data-dir={folder / 'profile'}", f"--log-net-log={self.log}"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(3, 4),
            preexec_fn=descriptors,  # noqa: PLW1509 - nothing but system calls
        )
        os.close(ours[0])
        os.close(theirs[1])
        self._to, self._from = ours[1], theirs[0]
        target = self._call("Target.createTarget", {"url": "about:blank"})["targetId"]
        attached = self._call("Target.attachToTarget", {"targetId": target, "flatten": True})
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log"):
            self._call(f"{domain}.enable")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the browser; its log of the network is complete then."""
        if self._process.poll() is None:
            os.write(self._to, json.dumps({"id": 0, "method": "Browser.close"}).encode() + b"\0")
            try:
                self._process.wait(20)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()
            os.close(self._to)
            os.close(self._from)

    def open(self, address: str) -> None:
        """Go to a page, and wait until it is loaded."""
        self._call("Page.navigate", {"url": address})
        while self._next().get("method") != "Page.loadEventFired":
            pass

    def picture(self) -> Picture:
        """The page as it is now, (h, w, 3)."""
        data = self._call("Page.captureScreenshot", {"format": "png"})["data"]
        return np.asarray(Pixels.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))

    def settled_picture(self, least_colours: int, patience_s: float = 90.0) -> Picture:
        """The page once two pictures in turn are alike and have at least so many colours."""
        deadline, last = time.monotonic() + patience_s, self.picture()
        while time.monotonic() < deadline:
            time.sleep(1.5)
            now = self.picture()
            if number_of_colours(now) >= least_colours and np.array_equal(now, last):
                return now
            last = now
        raise AssertionError(
            f"the page has {number_of_colours(last)} colours after {patience_s:g} s: {self.words}"
        )

    def click(self, x: int, y: int) -> None:
        """Click on the page."""
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            buttons = {} if kind == "mouseMoved" else {"button": "left", "clickCount": 1}
            self._call("Input.dispatchMouseEvent", {"type": kind, "x": x, "y": y, **buttons})
            time.sleep(0.1)

    def _call(self, method: str, params: dict[str, Any] | None = None) -> Any:
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": params or {}}
        if hasattr(self, "_session"):
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            found = self._next()
            if found.get("id") == self._number:
                assert "error" not in found, found
                return found["result"]
            if found.get("method") in (
                "Runtime.consoleAPICalled",
                "Runtime.exceptionThrown",
                "Log.entryAdded",
            ):
                self.words.append(json.dumps(found["params"])[:300])

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._buffer:
            part = os.read(self._from, 1 << 20)
            assert part, "the browser has ended"
            self._buffer += part
        line, _, self._buffer = self._buffer.partition(b"\0")
        return dict(json.loads(line))


def number_of_colours(picture: Picture) -> int:
    """How many different colours a picture has."""
    packed = picture.astype(np.uint32) @ np.array([65536, 256, 1], np.uint32)
    return len(np.unique(packed))


def hosts(log: Path) -> set[str]:
    """Every host that a browser's network log names in what a page on this computer has caused.

    Chromium itself asks its maker for this and that; such events name no page as their cause.
    """
    text = log.read_text().rstrip().rstrip(",")
    data = json.loads(text if text.endswith("}") else text + "]}")
    found: set[str] = set()
    for event in data["events"]:
        params = event.get("params", {})
        cause = " ".join(str(params.get(key, "")) for key in CAUSES)
        for key in ("url", "host"):
            word = params.get(key)
            if isinstance(word, str) and "127.0.0.1" in cause:
                name = urlsplit(word if "://" in word else f"//{word}").hostname
                found.update([name] if name else [])
    return found
