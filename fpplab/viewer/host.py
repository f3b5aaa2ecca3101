"""The process that serves the viewer's page, or feeds its window; it needs the standard library alone.

Its standard input is a pipe from its parent, with the recording as it grows: when that ends, this process
ends. It reports on standard output, a line of JSON each: its address, then whenever the last page is closed.

rerun's own server gives what is recorded to any page of any site, and its page sends usage statistics. So the
page here loads rerun's compiled viewer, and this server answers only who knows its random token.
"""

import ctypes
import http.client
import json
import os
import secrets
import shutil
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

LOCAL = "127.0.0.1"
START_TIMEOUT_S = 20.0  # longest time in s that rerun may take to start (chosen)
MEMORY_LIMIT = "1GB"  # memory limit of rerun's window (chosen)
MAX_BYTES, FIRST_MESSAGES = 1 << 30, 200
"""Bytes of a growing recording that are kept for pages opened later, and how many of its first messages are
among them in any case (chosen)."""
OWN_FILES = {"": "page.html", "page.css": "page.css", "page.js": "page.js"}
RERUN_FILES = ("re_viewer.js", "re_viewer_bg.wasm", "favicon.svg")
RECORDING = "recording.rrd"
CONTENT_TYPES = {
    ".html": "text/html",
    ".css": "text/css",
    ".js": "text/javascript",
    ".wasm": "application/wasm",
    ".svg": "image/svg+xml",
}
POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self' 'wasm-unsafe-eval'",
        "style-src 'self'",
        "img-src 'self' data: blob:",
        "connect-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        f"frame-ancestors http://{LOCAL}:*",  # the page of the set-up
    )
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-DNS-Prefetch-Control": "off",
    "Cache-Control": "no-store",
}
PR_SET_PDEATHSIG = 1  # linux's number of the option that sets the signal at the end of the parent


def run(program: str, kind: str, file: str) -> None:
    """Serve a file, or else what comes on standard input, until that ends or the window is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which then ends this process
    home = Path(tempfile.mkdtemp(prefix="fpplab-viewer-"))
    rerun: subprocess.Popen[bytes] | None = None
    try:
        if kind == "browser":
            _fetch_rerun_files(program, home)
            growing = GrowingRecording()
            recording = partial(_parts_of, Path(file)) if file else growing.messages
            _report({"page": PageServer(home, recording).address})
            _receive(growing.add)
        else:
            rerun = _open_window(program, file, home)
            threading.Thread(target=_feed_window, args=(rerun,), daemon=True).start()
            _report({"page": "window"})
            rerun.wait()
    except OSError as error:
        _report({"fault": str(error)})
    finally:
        if rerun is not None:
            _end(rerun)
        shutil.rmtree(home, ignore_errors=True)


def _report(values: dict[str, Any]) -> None:
    with suppress(OSError):  # the parent reads no more
        sys.stdout.write(json.dumps(values) + "\n")
        sys.stdout.flush()


def _fetch_rerun_files(program: str, home: Path) -> None:
    """Have rerun serve what its page consists of, once, and end it before there is anything to see."""
    data, web = _find_free_ports(2)
    options = ["--port", str(data), "--serve-web", "--web-viewer-port", str(web)]
    rerun = _start_rerun(program, options, home)
    try:
        _wait_until(lambda: _is_listening(web), rerun, home)
        for name in RERUN_FILES:
            source = http.client.HTTPConnection(LOCAL, web, timeout=START_TIMEOUT_S)
            source.request("GET", f"/{name}")
            with (home / name).open("wb") as stream:
                shutil.copyfileobj(source.getresponse(), stream, 1 << 20)
            source.close()
    finally:
        _end(rerun)


def _open_window(program: str, file: str, home: Path) -> subprocess.Popen[bytes]:
    # It would serve what it shows, unless it is told that another program does: a port here that never
    # answers.
    with socket.create_server((LOCAL, 0)) as other:
        other.settimeout(0.05)
        address = f"rerun+http://{LOCAL}:{other.getsockname()[1]}/proxy"
        options = ["--connect", address, "--memory-limit", MEMORY_LIMIT]
        rerun = _start_rerun(program, [file or "-", *options], home, stdin=subprocess.PIPE)
        connections: list[socket.socket] = []

        def is_connected() -> bool:
            with suppress(TimeoutError):
                connections.append(other.accept()[0])
            return bool(connections)

        _wait_until(is_connected, rerun, home)
    _never_answered.extend(connections)
    return rerun


_never_answered: list[socket.socket] = []  # connections of windows, which are kept open


def _start_rerun(
    program: str, options: list[str], home: Path, stdin: int = subprocess.DEVNULL
) -> subprocess.Popen[bytes]:
    """Start rerun, with settings of its own in which it sends no usage statistics."""
    environment = {**os.environ, "XDG_CONFIG_HOME": str(home), "RUST_LOG": "warn"}
    subprocess.run(
        [program, "analytics", "disable"],
        env=environment,
        timeout=START_TIMEOUT_S,
        check=False,  # the next start reports what is wrong with the program
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    command = [program, *options, "--bind", LOCAL, "--hide-welcome-screen"]
    with (home / "log").open("wb") as log:
        return subprocess.Popen(
            command,
            stdin=stdin,
            stdout=log,
            stderr=log,
            env=environment,
            preexec_fn=_dying_with_parent(),  # noqa: PLW1509 - no other thread holds a lock then
        )


def _end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()


def _dying_with_parent() -> Callable[[], None] | None:
    """Have the kernel end rerun with this process, however this ends; Linux alone can."""
    if not sys.platform.startswith("linux"):
        return None
    libc = ctypes.CDLL(None)
    return lambda: libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def _feed_window(rerun: subprocess.Popen[bytes]) -> None:
    assert rerun.stdin is not None
    with suppress(OSError):
        _receive(rerun.stdin.write, rerun.stdin.flush)
    rerun.kill()


def _wait_until(done: Callable[[], bool], rerun: subprocess.Popen[bytes], home: Path) -> None:
    deadline = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline:
        if done():
            return
        if rerun.poll() is not None:
            output = (home / "log").read_text(errors="replace").strip().splitlines()
            raise OSError(f"rerun ended: {output[-1] if output else 'no reason given'}")
        time.sleep(0.05)
    raise OSError(f"rerun did not start within {START_TIMEOUT_S:g} s")


def _is_listening(port: int) -> bool:
    with suppress(OSError), socket.create_connection((LOCAL, port), 1.0):
        return True
    return False


def _find_free_ports(count: int) -> list[int]:
    sockets = [socket.create_server((LOCAL, 0)) for _ in range(count)]
    ports = [int(s.getsockname()[1]) for s in sockets]
    for s in sockets:
        s.close()
    return ports


def _parts_of(path: Path) -> Iterator[bytes]:
    with path.open("rb") as stream:
        while part := stream.read(1 << 20):
            yield part


class GrowingRecording:
    """Messages of a recording: its beginning, which has what stays, and its end, if it is long."""

    def __init__(self) -> None:
        self._messages: dict[int, bytes] = {}
        self._count = self._bytes = self._after_gap = 0
        self._changed = threading.Condition()

    def add(self, message: bytes) -> None:
        with self._changed:
            self._messages[self._count] = message
            self._count += 1
            self._bytes += len(message)
            while self._bytes > MAX_BYTES and len(self._messages) > FIRST_MESSAGES:
                dropped = max(self._after_gap, FIRST_MESSAGES)
                self._bytes -= len(self._messages.pop(dropped))
                self._after_gap = dropped + 1
            self._changed.notify_all()

    def messages(self) -> Iterator[bytes]:
        """Give the messages from the first, without end: those to come are waited for."""
        number = 0
        while True:
            with self._changed:
                while number >= self._count:
                    self._changed.wait()
                number = number if number in self._messages else self._after_gap
                message = self._messages[number]
            number += 1
            yield message


def _receive(add: Callable[[bytes], object], flush: Callable[[], object] = lambda: None) -> None:
    """Take a recording in pieces, of which each is a recording by itself: a head, messages, an end."""
    stream, begun = sys.stdin.buffer, False
    while len(start := stream.read(4)) == 4:
        if start == b"RRF2":
            head = start + stream.read(8)
            if not begun:
                add(head)
            begun = True
            continue
        head = start + stream.read(12)
        kind, length = struct.unpack("<QQ", head)
        content = stream.read(length)
        if kind:
            add(head + content)
        else:  # the end of a piece
            flush()


class PageServer:
    """The page and its recording, served in threads of this process to who knows their address."""

    def __init__(self, rerun_folder: Path, recording: Callable[[], Iterable[bytes]]) -> None:
        self.rerun_folder, self.recording = rerun_folder, recording
        self.open_pages = 0
        self.lock = threading.Lock()

        class Handler(_PageHandler):
            page = self

        server = ThreadingHTTPServer((LOCAL, 0), Handler)
        server.daemon_threads = True
        self.host = f"{LOCAL}:{server.server_address[1]}"
        self.path = f"/{secrets.token_urlsafe(18)}/"
        self.address = f"http://{self.host}{self.path}"
        threading.Thread(target=server.serve_forever, daemon=True).start()


class _PageHandler(BaseHTTPRequestHandler):
    page: PageServer
    timeout = 30.0

    def do_GET(self) -> None:
        name = self._name()
        if name is None:
            self.send_error(403)
        elif name in OWN_FILES:
            self._send(_parts_of(Path(__file__).parent / "web" / OWN_FILES[name]), OWN_FILES[name])
        elif name in RERUN_FILES:
            self._send(_parts_of(self.page.rerun_folder / name), name)
        elif name == RECORDING:
            self._send(self.page.recording(), name)
        elif name == "open":
            self._stay_open()
        else:
            self.send_error(404)

    def _name(self) -> str | None:
        """What is asked for; None where it is not the page itself that asks."""
        page = self.page
        # Another host is a foreign name that was pointed at this computer.
        is_own = self.headers.get("Host") == page.host
        is_own &= self.headers.get("Origin") in (None, f"http://{page.host}")
        given, own = self.path[: len(page.path)].encode(), page.path.encode()
        return self.path[len(page.path) :] if secrets.compare_digest(given, own) and is_own else None

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the name of the overridden method
        """Log nothing."""

    def _head(self, kind: str) -> None:
        self.send_response(200)
        for name, value in {"Content-Type": kind, **HEADERS}.items():
            self.send_header(name, value)
        self.end_headers()

    def _send(self, parts: Iterable[bytes], name: str) -> None:
        self._head(CONTENT_TYPES.get(Path(name).suffix, "application/octet-stream"))
        with suppress(OSError):  # the page was closed
            for part in parts:
                self.wfile.write(part)

    def _stay_open(self) -> None:
        """Keep a request open for as long as its page is, and report when the last one is closed."""
        page = self.page
        with page.lock:
            page.open_pages += 1
        self.connection.settimeout(None)
        self._head("text/plain")
        with suppress(OSError):
            self.wfile.flush()
            self.connection.recv(1)  # ends when the browser closes the connection
        with page.lock:
            page.open_pages -= 1
        time.sleep(2.0)  # a page that is only loaded again is open by then
        if page.open_pages == 0:
            _report({"closed": True})


if __name__ == "__main__":
    run(*sys.argv[1:])
