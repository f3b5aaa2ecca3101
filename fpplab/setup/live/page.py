"""The page of the set-up: a small server on this computer alone, for the buttons and the present state.

Foreign pages in the same browser can neither read nor order anything: addresses hold a random token, and
requests must be for this very host and port, orders from the page itself.
"""

import json
import secrets
import threading
import time
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from types import TracebackType
from typing import Any, Self

from fpplab.setup.live.orders import WORDS, Order, Orders
from fpplab.setup.live.status import LiveStatus

LOCAL = "127.0.0.1"
MAX_BODY_BYTES = 200  # longest body of a request that is read: an order has 20 (chosen)

RELOAD_S = 4.0  # time in s within which a page that was left is loaded again (chosen)

TEMPLATE = "page.html"


class SetUpPage:
    """The page, served while a `with` block lasts."""

    def __init__(self, orders: Orders, viewer: str | None = None) -> None:
        self._orders, self._viewer = orders, viewer
        self._token = secrets.token_urlsafe(18)
        self._state = b"{}"
        self._left_s: float | None = None
        self._opened = False
        self._server = ThreadingHTTPServer((LOCAL, 0), _handler(self))
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True)
        self.host = f"{LOCAL}:{self._server.server_address[1]}"
        self.address = f"http://{self.host}/{self._token}/"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    @property
    def is_opened(self) -> bool:
        return self._opened

    @property
    def closed(self) -> bool:
        return self._left_s is not None and time.monotonic() - self._left_s > RELOAD_S

    def show(self, status: LiveStatus) -> None:
        self._state = json.dumps(status.summary()).encode()

    def answer(
        self, method: str, path: str, host: str, origin: str | None, body: bytes
    ) -> tuple[int, str, bytes]:
        if host not in (self.host, self.host.replace(LOCAL, "localhost")):
            return _refused(HTTPStatus.FORBIDDEN, "this page is for this computer alone")
        _, token, *rest = (*path.split("/"), "", "")
        if not secrets.compare_digest(token.encode(), self._token.encode()):
            return _refused(HTTPStatus.FORBIDDEN, "open the address that 'fpplab live' has printed")
        if method == "POST" and origin not in (None, f"http://{host}"):
            return _refused(HTTPStatus.FORBIDDEN, "orders come from the page of 'fpplab live' itself")
        return self._content(method, rest[0], body)

    def _content(self, method: str, name: str, body: bytes) -> tuple[int, str, bytes]:
        if (method, name) == ("GET", ""):
            return HTTPStatus.OK, "text/html; charset=utf-8", self._page_html()
        if (method, name) == ("GET", "state"):
            self._left_s, self._opened = None, True
            return HTTPStatus.OK, "application/json", self._state
        if (method, name) == ("POST", "leave"):
            self._left_s = time.monotonic()
            return HTTPStatus.OK, "application/json", b"{}"
        if (method, name) == ("POST", "order"):
            return self._accept_order(body)
        return _refused(HTTPStatus.NOT_FOUND, "there is no such address")

    def _accept_order(self, body: bytes) -> tuple[int, str, bytes]:
        try:
            order = Order(json.loads(body)["order"])
        except (ValueError, KeyError, TypeError):
            return _refused(HTTPStatus.BAD_REQUEST, f"an order is one of {', '.join(Order)}")
        self._orders.put(order)
        return HTTPStatus.ACCEPTED, "application/json", b"{}"

    def _page_html(self) -> bytes:
        text = files(__package__).joinpath(TEMPLATE).read_text(encoding="utf-8")
        orders = {order.value: {"key": key, "label": label} for order, (key, label) in WORDS.items()}
        content = json.dumps({"orders": orders, "viewer": self._viewer}).replace("<", "\\u003c")
        return text.replace("{{given}}", content).encode()

    def headers(self) -> dict[str, str]:
        frame = "'none'" if self._viewer is None else "http://" + self._viewer.split("/")[2]
        policy = (
            "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'; "
            f"frame-src {frame}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
        )
        return {
            "Content-Security-Policy": policy,
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
            "Cache-Control": "no-store",
        }


def _refused(status: HTTPStatus, why: str) -> tuple[int, str, bytes]:
    return status, "application/json", json.dumps({"error": why}).encode()


def _handler(page: SetUpPage) -> type[BaseHTTPRequestHandler]:
    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"
        timeout = 30.0

        def _respond(self, method: str) -> None:
            length = self.headers.get("Content-Length") or "0"
            size = int(length) if length.isdigit() else MAX_BODY_BYTES + 1
            if size > MAX_BODY_BYTES:
                self.close_connection = True
                self._send(*_refused(HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "an order is short"))
                return
            body, host = self.rfile.read(size), self.headers.get("Host", "")
            self._send(*page.answer(method, self.path, host, self.headers.get("Origin"), body))

        def _send(self, status: int, kind: str, content: bytes) -> None:
            self.send_response(status)
            headers = page.headers() | {"Content-Type": kind, "Content-Length": str(len(content))}
            for name, value in headers.items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(content)

        def do_GET(self) -> None:
            self._respond("GET")

        def do_POST(self) -> None:
            self._respond("POST")

        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - the name that it has there
            """Say nothing on stderr."""

    return Handler
