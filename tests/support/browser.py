"""A headless Chromium, driven through its debugging pipe; it logs what it asks of the network."""

import base64
import io
import json
import os
import select
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image as Pixels

SWITCHES = (
    "--headless",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-default-apps",
    "--disable-features=AutofillServerCommunication,OptimizationHints",
    "--hide-scrollbars",
)
SOFTWARE_WEBGL = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
NO_WEBGL = ("--disable-gpu", "--disable-3d-apis")
CAUSES = ("initiator", "network_isolation_key", "network_anonymization_key", "site_for_cookies")
"""What an event of the network log names as its cause."""

Picture = NDArray[np.uint8]


class Browser:
    """One page of a running Chromium; `log` is complete once it has ended."""

    def __init__(self, process: subprocess.Popen[bytes], to: int, out: int, log: Path) -> None:
        self.log = log
        self._process, self._to, self._out = process, to, out
        self._buffer, self._last = b"", 0
        self.events: list[dict[str, Any]] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self._session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Network", "Log"):
            self.call(f"{domain}.enable")

    _session: str | None = None

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Call a method of the protocol and wait for its result; events are kept."""
        self._last += 1
        message = {"id": self._last, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._to, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._read(60.0)
            if answer.get("id") == self._last:
                assert "error" not in answer, answer
                result: dict[str, Any] = answer["result"]
                return result
            self.events.append(answer)

    def _read(self, seconds: float) -> dict[str, Any]:
        end = time.monotonic() + seconds
        while b"\0" not in self._buffer:
            ready, _, _ = select.select([self._out], [], [], max(0.0, end - time.monotonic()))
            assert ready, "Chromium does not answer"
            part = os.read(self._out, 1 << 20)
            assert part, f"Chromium ended with {self._process.poll()}"
            self._buffer += part
        message, _, self._buffer = self._buffer.partition(b"\0")
        told: dict[str, Any] = json.loads(message)
        return told

    def open(self, page: Path | str, width: int = 1280, height: int = 900, dark: bool = False) -> None:
        """Open a file or an address in a window of this size, and wait until it is loaded."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self.call("Emulation.setEmulatedMedia", features=[scheme])
        self.events.clear()
        self.call("Page.navigate", url=page if isinstance(page, str) else page.resolve().as_uri())
        self.until("document.readyState === 'complete'")

    def run(self, script: str) -> Any:
        """The value of an expression, which may be a promise."""
        done = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in done, done
        return done["result"].get("value")

    def until(self, script: str, seconds: float = 30.0) -> None:
        """Wait until an expression holds."""
        end = time.monotonic() + seconds
        while not self.run(script):
            assert time.monotonic() < end, f"never came: {script}"
            time.sleep(0.05)

    def screenshot(self, path: Path, whole: bool = False) -> bytes:
        """The window, or the whole page, as a PNG file, which is kept."""
        shot = self.call("Page.captureScreenshot", format="png", captureBeyondViewport=whole)
        data = base64.b64decode(shot["data"])
        path.write_bytes(data)
        return data

    def settled_picture(self, path: Path, least_colours: int, patience_s: float = 90.0) -> Picture:
        """The window, kept as a PNG file, once two pictures in turn are alike and have so many colours."""
        deadline, last = time.monotonic() + patience_s, b""
        while time.monotonic() < deadline:
            now = self.screenshot(path)
            if now == last and number_of_colours(pixels_of(now)) >= least_colours:
                return pixels_of(now)
            last = now
            time.sleep(1.5)
        colours = number_of_colours(pixels_of(last))
        raise AssertionError(f"the page has {colours} colours after {patience_s:g} s: {self.faults()}")

    def coloured_picture(self, path: Path, least_colours: int, patience_s: float = 90.0) -> Picture:
        """The window, kept as a PNG file, once it has so many colours; it may go on changing."""
        deadline = time.monotonic() + patience_s
        while number_of_colours(now := pixels_of(self.screenshot(path))) < least_colours:
            assert time.monotonic() < deadline, f"{number_of_colours(now)} colours: {self.faults()}"
            time.sleep(1.0)
        return now

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag the mouse from one place of the window to another."""
        for kind, (x, y), held in (
            ("mousePressed", start, 1),
            ("mouseMoved", end, 1),
            ("mouseReleased", end, 0),
        ):
            self.call(
                "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=held, clickCount=1
            )

    def faults(self) -> list[str]:
        """Errors and warnings of the console, and uncaught exceptions, since the page was opened."""
        return [
            json.dumps(event["params"])
            for event in self.events
            if event.get("method") == "Runtime.exceptionThrown"
            or (
                event.get("method") == "Log.entryAdded"
                and event["params"]["entry"]["level"] in ("error", "warning")
            )
            or (
                event.get("method") == "Runtime.consoleAPICalled"
                and event["params"]["type"] in ("error", "warning", "assert")
            )
        ]

    def requests(self) -> list[str]:
        """What the page asked for since it was opened, but for what lies inside of it."""
        asked = [
            event["params"]["request"]["url"]
            for event in self.events
            if event.get("method") == "Network.requestWillBeSent"
        ]
        return [url for url in asked if not url.startswith(("data:", "blob:"))]

    def wait_closed(self) -> None:
        """End it."""
        self._session = None
        try:
            self.call("Browser.close")
        except (AssertionError, OSError):
            self._process.kill()
        self._process.wait(20)


@contextmanager
def chromium(folder: Path, *more: str) -> Iterator[Browser]:
    """A running Chromium with a profile of its own; the test is skipped where none is installed."""
    program = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if program is None:
        pytest.skip("Chromium is not installed; apt-get install chromium")
    (theirs_in, to), (out, theirs_out) = os.pipe(), os.pipe()

    log = folder / "net-log.json"
    own = [f"--user-data-dir={folder / 'profile'}", f"--log-net-log={log}"]
    command = [program, *SWITCHES, *more, "--remote-debugging-pipe", *own]
    # The protocol's pipe is descriptors 3 and 4 of the child: bash puts ours there.
    shell = ["bash", "-c", f'exec "$@" 3<&{theirs_in} 4>&{theirs_out}', "bash", *command]
    process = subprocess.Popen(
        shell,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        pass_fds=(theirs_in, theirs_out),
    )
    os.close(theirs_in)
    os.close(theirs_out)
    try:
        browser = Browser(process, to, out, log)
        yield browser
        browser.wait_closed()
    finally:
        if process.poll() is None:
            process.kill()
            process.wait(20)
        os.close(to)
        os.close(out)


def pixels_of(png: bytes) -> Picture:
    """A PNG file as (h, w, 3)."""
    return np.asarray(Pixels.open(io.BytesIO(png)).convert("RGB"))


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
