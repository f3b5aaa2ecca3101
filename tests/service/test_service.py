"""A service takes orders of its clients, says how far they are, and loses none; strangers get nothing."""

import contextlib
import http.client
import json
import socket
import ssl
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fpplab.core.errors import ConfigError, DataError
from fpplab.devices.rig_lock import announced_service
from fpplab.service.client import ServiceClient, ServiceError
from fpplab.service.limits import LIMITS
from fpplab.service.order import ScanOrder
from fpplab.service.serving import ServiceAddress, make_token
from fpplab.service.state import ScanState
from tests.service.stubs import TOKEN, Bench, Orders, served
from tests.support.certificates import make_certificate


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


@pytest.fixture
def queue(bench: Bench, tmp_path: Path) -> Orders:
    return Orders(bench, tmp_path / "out")


@pytest.fixture
def client(queue: Orders, bench: Bench) -> Iterator[ServiceClient]:
    with served(queue, bench) as client:
        yield client


def asked(client: ServiceClient, method: str, path: str, body: Any = None, **headers: str) -> tuple[int, str]:
    """Status and body of an answer, with the token unless headers say otherwise."""
    with contextlib.closing(http.client.HTTPConnection(client._host, client._port, timeout=5)) as connection:
        connection.request(method, path, body, {"Authorization": f"Bearer {TOKEN}", **headers})
        answer = connection.getresponse()
        return answer.status, answer.read().decode()


def test_a_client_is_told_of_the_light_before_the_points(
    client: ServiceClient, queue: Orders, bench: Bench
) -> None:
    states: list[str] = []
    bench.scan = lambda observer: states.append(client.wait(scan, "exposed", 2.0)["state"])
    scan = client.order("plan_paper", item="pyramid")
    assert client.show(scan)["state"] == "queued"
    queue.work_once(0)
    assert states == ["exposed"]
    status = client.wait(scan)
    assert (status["verdict"], status["points"], status["result"]["points"]) == ("good", 2, 2)
    assert announced_service(bench.rig.source) == {**announced_service(bench.rig.source), "token": TOKEN}  # type: ignore[dict-item]


def test_a_scan_is_cancelled_before_and_while_it_is_done(
    client: ServiceClient, queue: Orders, bench: Bench
) -> None:
    first, second = client.order("plan_paper"), client.order("plan_paper")
    client.cancel(second)

    def cancelled(observer: Any) -> None:
        client.cancel(first)
        with observer.stage("Reconstructing") as progress:
            progress(0.5)

    bench.scan = cancelled
    queue.work_once(0)
    queue.work_once(0)
    assert [queue.get(n).state for n in (first, second)] == [ScanState.CANCELLED] * 2  # type: ignore[union-attr]
    with pytest.raises(ServiceError) as refused:
        client.wait(first)
    assert refused.value.exit_code == 130


def test_what_fails_is_said_with_its_exit_code(client: ServiceClient, queue: Orders, bench: Bench) -> None:
    def failing(_: object) -> None:
        raise DataError("a frame is damaged")

    bench.scan = failing
    scan = client.order("plan_paper")
    queue.work_once(0)
    with pytest.raises(ServiceError, match="a frame is damaged") as refused:
        client.wait(scan)
    assert refused.value.exit_code == 4


def test_results_are_found_again_and_nothing_is_lit_unasked(
    queue: Orders, bench: Bench, tmp_path: Path
) -> None:
    queue.accept(ScanOrder(out="a"))
    queue.work_once(0)
    queue.accept(ScanOrder(out="b"))
    later = Orders(bench, tmp_path / "out")
    later.work_once(0)
    assert [status.state for status in later.latest(9)] == [ScanState.INTERRUPTED, ScanState.FINISHED]
    first = later.get(1)
    assert first is not None
    assert first.result == {"points": 2, "cloud": "x"}
    assert later.accept(ScanOrder(out="b")).id == 3


def test_the_latest_records_are_kept_and_read_when_they_are_asked_for(
    queue: Orders, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fpplab.service.queue.LIMITS", replace(LIMITS, max_records=3))
    for _ in range(5):
        queue.accept(ScanOrder(out="a"))
        queue.work_once(0)
    records = tmp_path / "out" / ".scans"
    assert sorted(path.stem for path in records.iterdir()) == ["000003", "000004", "000005"]
    (records / "000003.json").write_text("not asked for")
    later = Orders(bench, tmp_path / "out")
    assert [status.id for status in later.latest(2)] == [5, 4]
    with pytest.raises(DataError, match="is not the record of a scan"):
        later.get(3)


def test_an_interruption_is_recorded_and_goes_on(queue: Orders, bench: Bench) -> None:
    def interrupted(_: object) -> None:
        raise KeyboardInterrupt

    bench.scan = interrupted
    queue.accept(ScanOrder(out="a"))
    with pytest.raises(KeyboardInterrupt):
        queue.work_once(0)
    assert queue.latest(1)[0].state is ScanState.INTERRUPTED


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Authorization": ""}, 401),
        ({"Authorization": "Bearer wrong"}, 401),
        ({"Origin": "https://example.org"}, 403),
        ({"Host": "rebound.example.org"}, 403),
        ({"Content-Length": str(1 << 30)}, 413),
    ],
)
def test_strangers_are_refused(
    client: ServiceClient, queue: Orders, headers: dict[str, str], status: int
) -> None:
    assert asked(client, "POST", "/scans", None, **headers)[0] == status
    assert queue.latest(9) == []


def test_a_body_without_end_is_refused(client: ServiceClient, queue: Orders) -> None:
    chunks = (b" " * 65536 for _ in range(2 * LIMITS.max_body_bytes // 65536))
    with contextlib.suppress(OSError):  # it is told so while it still sends
        assert asked(client, "POST", "/scans", chunks)[0] == 413
    assert queue.latest(9) == []
    assert asked(client, "GET", "/rig")[0] == 200


def test_a_thousand_connections_do_not_keep_a_client_out(client: ServiceClient) -> None:
    held = [socket.create_connection((client._host, client._port)) for _ in range(1000)]
    try:
        assert asked(client, "GET", "/rig")[0] == 200
    finally:
        for connection in held:
            connection.close()


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b"{", "is not JSON"),
        (b"[]", "is not an object"),
        (b'{"plan": "p", "speed": 9}', "unknown key 'speed'"),
        (b'{"pose": -1}', "'pose' is -1"),
    ],
)
def test_a_wrong_order_is_one_sentence(client: ServiceClient, body: bytes, words: str) -> None:
    status, answer = asked(client, "POST", "/scans", body)
    assert status == 422
    assert words in json.loads(answer)["error"]


def test_the_page_of_the_interface_fetches_nothing_from_elsewhere(client: ServiceClient) -> None:
    status, page = asked(client, "GET", "/docs", Authorization="")
    assert status == 200
    assert "http" not in page.replace("https://fastapi.tiangolo.com/img/favicon.png", "")
    schema = json.loads(asked(client, "GET", "/openapi.json", Authorization="")[1])
    assert {"/scans", "/scans/{number}", "/rig"} <= set(schema["paths"])


@pytest.mark.parametrize("name", ["../plan.yaml", "/etc/passwd", "..", "a\\b", "C:b", "con"])
def test_another_computer_names_nothing_outside_the_folder(name: str) -> None:
    for field in ("plan", "calibration", "out", "limits"):
        with pytest.raises(ConfigError, match=field):
            ScanOrder(**{field: name}).check_remote()
    for order in (ScanOrder(folder="/"), ScanOrder.model_validate_json('{"allow": ["led-current"]}')):
        with pytest.raises(ConfigError, match="own computer"):
            order.check_remote()
    ScanOrder(plan="plan_paper", out="part_7").check_remote()


def test_other_computers_need_a_certificate_and_a_list(tmp_path: Path) -> None:
    for certificate, clients in ((None, ["10.0.0.0/8"]), (tmp_path, [])):
        with pytest.raises(ConfigError, match="beyond this computer"):
            ServiceAddress.parse("0.0.0.0:8787", certificate, [], clients)
    assert ServiceAddress.parse("0.0.0.0:8787", tmp_path, ["lab"], ["10.0.0.0/8"]).clients == ("10.0.0.0/8",)


def test_a_token_that_others_read_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "token"
    file.write_text(TOKEN)
    file.chmod(0o644)
    with pytest.raises(ConfigError, match="other users"):
        make_token(file)
    file.chmod(0o600)
    assert make_token(file) == TOKEN
    assert len(make_token(None)) >= len(TOKEN)


def test_a_certificate_is_that_of_the_service(queue: Orders, bench: Bench, tmp_path: Path) -> None:
    lab, other = make_certificate(tmp_path / "a"), make_certificate(tmp_path / "b")
    with served(queue, bench, certificate=lab) as client:
        assert client.show(client.order("plan_paper"))["state"] == "queued"
        foreign = ServiceClient(client.url, TOKEN, other)
        with pytest.raises(Exception, match="certificate verify failed") as refused:
            foreign.show(1)
        assert isinstance(refused.value.__cause__, ssl.SSLError)


def test_importing_the_product_does_not_import_the_framework() -> None:
    names = "{'fastapi', 'starlette', 'uvicorn', 'fpplab.service'}"
    code = f"import sys, fpplab, fpplab.cli; fpplab.ServiceClient; print({names} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "{'fpplab.service'}"
