"""The page: operated over HTTP, refused to everybody else."""

import http.client
import json
import re
from collections.abc import Iterator
from queue import Empty, SimpleQueue

import pytest

from fpplab.setup.live import page as served
from fpplab.setup.live.focus import FocusTracker
from fpplab.setup.live.orders import WORDS, Order
from fpplab.setup.live.page import SetUpPage
from fpplab.setup.live.patterns import View
from fpplab.setup.live.status import LiveStatus

STATUS = LiveStatus(7, 12.5, View.MEASURE, tuple(View), None, None, None, FocusTracker(), FocusTracker())


@pytest.fixture
def orders() -> SimpleQueue[Order]:
    return SimpleQueue()


@pytest.fixture
def page(orders: SimpleQueue[Order]) -> Iterator[SetUpPage]:
    with SetUpPage(orders, "http://127.0.0.1:9090/?url=x") as open_page:
        open_page.show(STATUS)
        yield open_page


def ask(
    page: SetUpPage, method: str, path: str, body: bytes | None = None, **headers: str
) -> tuple[int, bytes, http.client.HTTPMessage]:
    connection = http.client.HTTPConnection(page.host, timeout=10)
    try:
        connection.request(method, path, body, headers)
        reply = connection.getresponse()
        return reply.status, reply.read(), reply.headers
    finally:
        connection.close()


def path_of(page: SetUpPage) -> str:
    return "/" + page.address.split("/", 3)[3]


def order(page: SetUpPage, name: str, **headers: str) -> int:
    body = json.dumps({"order": name}).encode()
    return ask(page, "POST", path_of(page) + "order", body, **headers)[0]


def test_the_page_shows_the_state_and_takes_orders(page: SetUpPage, orders: SimpleQueue[Order]) -> None:
    code, text, _ = ask(page, "GET", path_of(page))
    assert code == 200
    assert b"127.0.0.1:9090" in text
    for name in Order:
        assert name.value in text.decode()
    code, state, _ = ask(page, "GET", path_of(page) + "state")
    assert code == 200
    assert json.loads(state) == json.loads(json.dumps(STATUS.summary()))
    assert json.loads(state)["frames"] == 7
    for name in Order:
        assert order(page, name.value, Origin=f"http://{page.host}") == 202
    assert [orders.get_nowait() for _ in Order] == list(Order)


def test_every_order_has_a_button_and_a_key(page: SetUpPage) -> None:
    _, text, _ = ask(page, "GET", path_of(page))
    buttons = " ".join(re.findall(r'data-orders="([^"]*)"', text.decode())).split()
    assert sorted(buttons) == sorted(name.value for name in Order)
    keys = [key for key, _ in WORDS.values()]
    assert len(set(keys)) == len(keys)


def test_nothing_is_fetched_from_elsewhere(page: SetUpPage) -> None:
    _, text, headers = ask(page, "GET", path_of(page))
    assert not re.findall(
        rb"""(?:src|href)\s*=|@import|url\(|https?://(?!127\.0\.0\.1)""", text.replace(b".src =", b"")
    )
    policy = headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'")
    assert "connect-src 'self'" in policy
    assert "frame-src http://127.0.0.1:9090" in policy
    assert "frame-ancestors 'none'" in policy
    assert headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize("token", ["", "guess", "%C3%A9tat", "."])
def test_without_the_token_nothing_is_told_or_done(
    token: str, page: SetUpPage, orders: SimpleQueue[Order]
) -> None:
    for method, name in (("GET", ""), ("GET", "state"), ("POST", "order")):
        code, text, _ = ask(
            page, method, f"/{token}/{name}", b'{"order": "quit"}' if method == "POST" else None
        )
        assert code == 403
        assert b"frames" not in text
    with pytest.raises(Empty):
        orders.get_nowait()


@pytest.mark.parametrize(
    "foreign",
    [
        {"Host": "evil.example"},  # a name that was made to point at this computer
        {"Host": "127.0.0.1"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
    ],
)
def test_foreign_pages_cannot_order(
    foreign: dict[str, str], page: SetUpPage, orders: SimpleQueue[Order]
) -> None:
    assert order(page, "quit", **foreign) == 403
    with pytest.raises(Empty):
        orders.get_nowait()
    assert ask(page, "GET", path_of(page) + "state", Host="evil.example")[0] == 403


def test_what_is_no_order_is_refused(page: SetUpPage) -> None:
    post = path_of(page) + "order"
    for body in (b"", b"[]", b'{"order": "explode"}', b'"quit"', b"\xff"):
        assert ask(page, "POST", post, body)[0] == 400
    assert ask(page, "POST", post, b"x" * 1000)[0] == 413
    assert ask(page, "GET", path_of(page) + "elsewhere")[0] == 404
    assert ask(page, "GET", path_of(page) + "order")[0] == 404


def test_a_page_that_was_closed_is_noticed(page: SetUpPage, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(served, "RELOAD_S", 0.0)
    assert not page.is_opened
    assert not page.closed  # nobody has opened it yet
    ask(page, "GET", path_of(page) + "state")
    assert page.is_opened
    ask(page, "POST", path_of(page) + "leave", b"")
    assert page.closed
    ask(page, "GET", path_of(page) + "state")  # loaded again
    assert not page.closed
