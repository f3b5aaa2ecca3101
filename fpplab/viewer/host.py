"""The process that runs rerun's program, serves its page, and ends with the process that started it.

It is started by `fpplab.viewer.server`, not imported, and needs the standard library alone. Its standard
input is a pipe from its parent: when that ends, because the parent wants so or because it was killed, rerun
is ended too. It reports on standard output, a line of JSON each: its address, then whenever the last page
in a browser is closed.

rerun's own page sends usage statistics and loads fonts from the network. It is not used: the page here loads
rerun's compiled viewer, under a content security policy that lets it reach nothing but this computer.
"""

from __future__ import annotations

import ctypes
import http.client
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

LOCAL = "127.0.0.1"
START_TIMEOUT_S = 20.0
"""Longest time in s that rerun may take to start (chosen)."""
MEMORY_LIMIT = "1GB"
"""Memory limit of rerun's server (chosen)."""
OWN_FILES = {"/": "page.html", "/page.css": "page.css", "/page.js": "page.js"}
"""Files of the page that are fpplab's."""
CONTENT_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
RERUN_FILES = ("/re_viewer.js", "/re_viewer_bg.wasm", "/favicon.svg")
"""Files of the page that rerun's program contains."""
PR_SET_PDEATHSIG = 1
"""Linux's number of the option that sets the signal at the end of the parent."""


def run(program: str, kind: str, files: list[str]) -> None:
    """Run rerun until it ends, or standard input does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which then ends this process
    home = tempfile.mkdtemp(prefix="fpplab-viewer-")
    rerun: subprocess.Popen[bytes] | None = None
    try:
        data, raw = _find_free_ports(2)
        rerun = _start_rerun(program, kind, files, data, raw, Path(home))
        threading.Thread(target=_end_with_parent, args=(rerun,), daemon=True).start()
        for port in (data, raw) if kind == "browser" else (data,):
            _wait_until_listening(rerun, port, Path(home) / "log")
        where = {"data": f"rerun+http://{LOCAL}:{data}/proxy", "pid": rerun.pid, "page": "window"}
        if kind == "browser":
            where["page"] = _serve_page(data, raw)
        _report(where)
        rerun.wait()
    except OSError as error:
        _report({"fault": str(error)})
    finally:
        if rerun is not None:
            rerun.kill()
            rerun.wait()
        shutil.rmtree(home, ignore_errors=True)


def _report(values: dict[str, Any]) -> None:
    with suppress(OSError):  # the parent reads no more
        sys.stdout.write(json.dumps(values) + "\n")
        sys.stdout.flush()


def _start_rerun(
    program: str, kind: str, files: list[str], data: int, raw: int, home: Path
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
    command = [program, *files, "--bind", LOCAL, "--port", str(data), "--hide-welcome-screen"]
    if kind == "browser":
        command += ["--serve-web", "--web-viewer-port", str(raw), "--server-memory-limit", MEMORY_LIMIT]
    else:
        command += ["--memory-limit", MEMORY_LIMIT]
        command += [] if files else ["--expect-data-soon"]
    with (home / "log").open("wb") as log:
        return subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
            env=environment,
            preexec_fn=_dying_with_parent(),  # noqa: PLW1509 - no other thread yet
        )


def _dying_with_parent() -> Callable[[], None] | None:
    """Have the kernel end rerun with this process, however this ends; Linux alone can."""
    if not sys.platform.startswith("linux"):
        return None
    libc = ctypes.CDLL(None)
    return lambda: libc.prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def _end_with_parent(rerun: subprocess.Popen[bytes]) -> None:
    with suppress(OSError):
        sys.stdin.buffer.read()
    rerun.kill()


def _wait_until_listening(rerun: subprocess.Popen[bytes], port: int, log: Path) -> None:
    deadline = time.monotonic() + START_TIMEOUT_S
    while time.monotonic() < deadline:
        if rerun.poll() is not None:
            output = log.read_text(errors="replace").strip().splitlines()
            raise OSError(f"rerun ended: {output[-1] if output else 'no reason given'}")
        with suppress(OSError), socket.create_connection((LOCAL, port), 1.0):
            return
        time.sleep(0.05)
    raise OSError(f"rerun did not start within {START_TIMEOUT_S:g} s")


def _find_free_ports(count: int) -> list[int]:
    sockets = [socket.create_server((LOCAL, 0)) for _ in range(count)]
    ports = [int(s.getsockname()[1]) for s in sockets]
    for s in sockets:
        s.close()
    return ports


def _serve_page(data: int, raw: int) -> str:
    """Serve the page in threads of this process; return its address."""

    class Handler(_PageHandler):
        data_port, raw_port = data, raw

    server = ThreadingHTTPServer((LOCAL, 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"http://{LOCAL}:{server.server_address[1]}/"


def _policy(data_port: int) -> str:
    """What the page may load, and what it may connect to."""
    return "; ".join(
        (
            "default-src 'none'",
            "script-src 'self' 'wasm-unsafe-eval'",
            "style-src 'self'",
            "img-src 'self' data: blob:",
            f"connect-src 'self' http://{LOCAL}:{data_port}",
            "base-uri 'none'",
            "form-action 'none'",
            f"frame-ancestors http://{LOCAL}:*",  # the page of the set-up
        )
    )


class _PageHandler(BaseHTTPRequestHandler):
    data_port: int
    raw_port: int
    _open_pages = 0
    _lock = threading.Lock()

    def do_GET(self) -> None:
        """Answer one request of the page."""
        address = f"{LOCAL}:{self.connection.getsockname()[1]}"
        if self.headers.get("Host") != address:  # a foreign name that was pointed at this computer
            self.send_error(403)
        elif self.path in OWN_FILES:
            self._own(OWN_FILES[self.path])
        elif self.path in RERUN_FILES:
            self._relayed()
        elif self.path == "/open":
            self._stay_open()
        else:
            self.send_error(404)

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the name of the overridden method
        """Log nothing."""

    def _head(self, kind: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Security-Policy", _policy(self.data_port))
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("X-DNS-Prefetch-Control", "off")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()

    def _own(self, name: str) -> None:
        text = (Path(__file__).parent / "web" / name).read_text()
        recording = f"rerun+http://{LOCAL}:{self.data_port}/proxy"
        self._head(CONTENT_TYPES[Path(name).suffix])
        self.wfile.write(text.replace("{{recording}}", recording).encode())

    def _relayed(self) -> None:
        source = http.client.HTTPConnection(LOCAL, self.raw_port, timeout=START_TIMEOUT_S)
        try:
            source.request("GET", self.path)
            answer = source.getresponse()
            self._head(answer.getheader("Content-Type", "application/octet-stream"))
            with suppress(OSError):  # the page was closed
                shutil.copyfileobj(answer, self.wfile, 1 << 20)
        finally:
            source.close()

    def _stay_open(self) -> None:
        """Keep a request open for as long as its page is, and report when the last one is closed."""
        cls = _PageHandler
        with cls._lock:
            cls._open_pages += 1
        self._head("text/plain")
        with suppress(OSError):
            self.wfile.flush()
            self.connection.recv(1)  # ends when the browser closes the connection
        with cls._lock:
            cls._open_pages -= 1
        time.sleep(2.0)  # a page that is only loaded again is open by then
        if cls._open_pages == 0:
            _report({"closed": True})


if __name__ == "__main__":
    run(sys.argv[1], sys.argv[2], sys.argv[3:])
