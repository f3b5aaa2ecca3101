"""What other sites, other programs and other computers ask of the two pages: they get nothing."""

import socket
from collections.abc import Iterator
from contextlib import ExitStack, suppress

import pytest

from fpplab.setup.live.orders import Orders
from fpplab.setup.live.page import SetUpPage
from fpplab.viewer.host import PageServer

SECRET = b"RRF2 the measurement"
MOST_ANSWERED = 2_000
"""Bytes of an answer that is a refusal."""


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """By name, the addresses of both pages."""
    home = tmp_path_factory.mktemp("page")
    with SetUpPage(Orders()) as live:
        yield {"live": live.address, "viewer": PageServer(home, lambda: [SECRET]).address}


WHAT = {"live": "state", "viewer": "recording.rrd"}
"""What is worth having."""

ATTACKS = {
    "no token": "GET /{what} HTTP/1.1\r\nHost: {host}\r\n\r\n",
    "another token": "GET /{other}/{what} HTTP/1.1\r\nHost: {host}\r\n\r\n",
    "part of the token": "GET /{part}/{what} HTTP/1.1\r\nHost: {host}\r\n\r\n",
    "the token behind": "GET /{what}/{token} HTTP/1.1\r\nHost: {host}\r\n\r\n",
    "the token in the query": "GET /{what}?{token} HTTP/1.1\r\nHost: {host}\r\n\r\n",
    "the token in a cookie": "GET /{what} HTTP/1.1\r\nHost: {host}\r\nCookie: {token}\r\n\r\n",
    "a token of other letters": "GET /\xff\xfe/{what} HTTP/1.1\r\nHost: {host}\r\n\r\n",
    "a name made to point here": "GET /{token}/{what} HTTP/1.1\r\nHost: example.com\r\n\r\n",
    "that name with the port": "GET /{token}/{what} HTTP/1.1\r\nHost: example.com:{port}\r\n\r\n",
    "the name as a user": "GET /{token}/{what} HTTP/1.1\r\nHost: {host}@example.com\r\n\r\n",
    "no name": "GET /{token}/{what} HTTP/1.1\r\n\r\n",
    "the name in the address": "GET http://example.com/{token}/{what} HTTP/1.1\r\nHost: example.com\r\n\r\n",
    "an order of another site": "POST /{token}/order HTTP/1.1\r\nHost: {host}\r\nOrigin: http://example.com\r\n"
    'Content-Length: 17\r\n\r\n{{"order": "quit"}}',
    "an order of a frame": "POST /{token}/order HTTP/1.1\r\nHost: {host}\r\nOrigin: null\r\n"
    'Content-Length: 17\r\n\r\n{{"order": "quit"}}',
    "a long body": "POST /{token}/order HTTP/1.1\r\nHost: {host}\r\nContent-Length: 99999999999\r\n\r\n",
    "a body below 0": "POST /{token}/order HTTP/1.1\r\nHost: {host}\r\nContent-Length: -1\r\n\r\n",
    "an endless line": "GET /" + "a" * 100_000,
    "a long address": "GET /" + "a" * 70_000 + " HTTP/1.1\r\nHost: {host}\r\n\r\n",
    "many headers": "GET / HTTP/1.1\r\nHost: {host}\r\n" + "X: y\r\n" * 5_000 + "\r\n",
    "another method": "TRACE /{token}/{what} HTTP/1.1\r\nHost: {host}\r\n\r\n",
    "asking first": "OPTIONS /{token}/{what} HTTP/1.1\r\nHost: {host}\r\nOrigin: http://example.com\r\n"
    "Access-Control-Request-Method: GET\r\n\r\n",
    "a WebSocket without token": "GET /{what} HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\n"
    "Connection: Upgrade\r\nSec-WebSocket-Key: AAAA\r\nSec-WebSocket-Version: 13\r\n\r\n",
    "a WebSocket by another name": "GET /{token}/{what} HTTP/1.1\r\nHost: example.com\r\n"
    "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: AAAA\r\n\r\n",
    "another protocol": "PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n",
    "no protocol": "\x00\x01\x02\r\n\r\n",
    "a file above": "GET /{token}/../../../../etc/passwd HTTP/1.1\r\nHost: {host}\r\n\r\n",
    "a file above, escaped": "GET /{token}/%2e%2e/%2e%2e/etc/passwd HTTP/1.1\r\nHost: {host}\r\n\r\n",
}
ATTACKS_ON_THE_VIEWER = {
    "another site": "GET /{token}/{what} HTTP/1.1\r\nHost: {host}\r\nOrigin: https://example.com\r\n\r\n",
    "another port": "GET /{token}/{what} HTTP/1.1\r\nHost: {host}\r\nOrigin: http://127.0.0.1:1\r\n\r\n",
    "a WebSocket of another site": "GET /{token}/{what} HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\n"
    "Connection: Upgrade\r\nOrigin: http://example.com\r\n\r\n",
    "rerun's own service": "POST /rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages HTTP/1.1\r\n"
    "Host: {host}\r\nContent-Type: application/grpc-web+proto\r\nContent-Length: 5\r\n\r\n" + "\x00" * 5,
}
CASES = {f"live: {name}": ("live", text) for name, text in ATTACKS.items()}
CASES |= {f"viewer: {name}": ("viewer", text) for name, text in {**ATTACKS, **ATTACKS_ON_THE_VIEWER}.items()}
REFUSALS = (b"400", b"403", b"404", b"413", b"414", b"431", b"501", b"505")


def connected(host: str) -> socket.socket:
    address, _, port = host.partition(":")
    return socket.create_connection((address, int(port)), 5.0)


def answer(host: str, request: bytes) -> bytes:
    """All that is answered until the connection is closed; a request without an end is ended."""
    said = b""
    with connected(host) as connection, suppress(OSError):  # closed, or reset
        connection.sendall(request)
        connection.shutdown(socket.SHUT_WR)
        while part := connection.recv(1 << 16):
            said += part
    return said


def filled(address: str, what: str, text: str) -> tuple[str, bytes]:
    _, _, host, token, _ = address.split("/")
    fields = {"host": host, "port": host.split(":")[1], "token": token, "part": token[:-1], "what": what}
    return host, text.format(**fields, other=token[::-1]).encode("latin-1")


@pytest.mark.parametrize(("page", "text"), CASES.values(), ids=CASES.keys())
def test_a_page_gives_nothing_away(pages: dict[str, str], page: str, text: str) -> None:
    host, request = filled(pages[page], WHAT[page], text)
    said = answer(host, request)
    assert SECRET not in said
    assert b"root:" not in said
    assert len(said) < MOST_ANSWERED
    if said and b"Error code" not in said[:200]:  # an answer to the first version of the protocol has no head
        assert said.split(b" ")[1] in REFUSALS
    assert b"access-control-allow" not in said.lower()
    assert b"101 Switching" not in said


@pytest.mark.parametrize("page", WHAT)
def test_the_page_itself_is_answered_while_others_hold_connections(pages: dict[str, str], page: str) -> None:
    host, request = filled(pages[page], WHAT[page], "GET /{token}/{what} HTTP/1.0\r\nHost: {host}\r\n\r\n")
    with ExitStack() as idle:
        for _ in range(4):
            idle.enter_context(connected(host)).sendall(b"GET / HT")
        said = answer(host, request)
    assert said.split(b" ")[1] == b"200"
    assert page == "live" or said.endswith(SECRET)
