"""Computers that measure together let nobody else in."""

import json
import os
import signal
import socket
import ssl
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from fpplab.core.errors import ConfigError, DeviceError
from fpplab.optimisation.cluster import Meeting, is_this_computer
from fpplab.optimisation.scheduling import DaskWorkers
from tests.optimisation.test_scheduling import TASKS, measured
from tests.support.certificates import make_certificate
from tests.support.commands import ROOT
from tests.support.searching import Formula

BEYOND = [
    "tcp://0.0.0.0:8786",
    "tcp://192.168.1.20:8786",
    "tcp://first-computer:8786",
    "192.168.1.20:8786",
    "tcp://[::]:8786",
    "tcp://[2001:db8::1]:8786",
    "tcp://[::ffff:192.168.1.20]:8786",
    "tcp://127.1:8786",
    "tcp://2130706433:8786",
    "tcp://0x7f.0.0.1:8786",
    "tcp://127.0.0.1.example.org:8786",
    "tcp://127.0.0.1@example.org:8786",
    "tcp://localhost.example.org:8786",
]
NO_ADDRESS = ["tcp://:8786", "nonsense", "http://127.0.0.1:1", "tcp://127.0.0.1", "ucx://127.0.0.1:1",
              "inproc://a/b/1", "tcp://127.0.0.1:70000", "tcp://127.0.0.1:-1", ""]  # fmt: skip


@pytest.mark.parametrize("address", BEYOND)
def test_no_other_computer_is_met_without_a_certificate(address: str) -> None:
    with pytest.raises(ConfigError, match=r"is beyond this computer.*give --certificate FOLDER"):
        Meeting.at(address, None)


@pytest.mark.parametrize("address", NO_ADDRESS)
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(ConfigError, match="is no address of a scheduler: write tls://HOST:PORT"):
        Meeting.at(address, None)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.8.9.1", "::1", "localhost"])
def test_this_computer_is_met_without_a_certificate(host: str) -> None:
    assert is_this_computer(host)
    assert Meeting.at(f"tcp://{f'[{host}]' if ':' in host else host}:8786", None).protocol == "tcp"


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_certificate(tmp_path_factory.mktemp("own") / "made")


def test_a_certificate_that_cannot_protect_is_refused(lab: Path, tmp_path: Path) -> None:
    other = make_certificate(tmp_path / "other")
    with pytest.raises(ConfigError, match="with --certificate it begins with tls://"):
        Meeting.at("tcp://127.0.0.1:8786", lab)
    with pytest.raises(ConfigError, match="needs a certificate"):
        Meeting.at("tls://127.0.0.1:8786", None)
    (other / "key.pem").chmod(0o644)
    with pytest.raises(ConfigError, match="can be read by other users"):
        Meeting.at("tls://127.0.0.1:8786", other)
    (other / "key.pem").chmod(0o600)
    (other / "certificate.pem").write_bytes((lab / "certificate.pem").read_bytes())
    with pytest.raises(ConfigError, match="its certificate cannot be used"):
        Meeting.at("tls://127.0.0.1:8786", other)
    (other / "key.pem").unlink()
    with pytest.raises(ConfigError, match=r"key\.pem: there is no such file"):
        Meeting.at("tls://127.0.0.1:8786", other)


@pytest.fixture(scope="module")
def scheduler(lab: Path) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A scheduler without workers, at an address that other computers could reach where this one has any."""
    own = [a.address for card in psutil.net_if_addrs().values() for a in card if a.family == socket.AF_INET]
    host = next((address for address in own if not address.startswith("127.")), "127.0.0.1")
    command = [sys.executable, "-m", "fpplab", "cluster", "--json", "--workers", "0", "--certificate",
               str(lab), "--listen", f"tls://{host}:0"]  # fmt: skip
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE) as served:
        try:
            assert served.stdout is not None
            yield json.loads(served.stdout.readline())["scheduler"], served
            served.send_signal(signal.SIGINT)
            assert served.wait(30) == 0
        finally:
            served.kill()


@pytest.mark.whole
def test_a_stranger_gets_nothing_and_runs_no_code(
    scheduler: tuple[str, subprocess.Popen[bytes]], lab: Path, tmp_path: Path
) -> None:
    distributed: Any = pytest.importorskip("distributed")
    address, _ = scheduler
    host, port = address.removeprefix("tls://").split(":")
    other, ran = make_certificate(tmp_path / "other"), tmp_path / "ran"
    for security, place in (
        (distributed.Security(require_encryption=False), f"tcp://{host}:{port}"),
        (Meeting.at(address, other).security, address),
    ):
        with (
            pytest.raises((OSError, RuntimeError, TimeoutError)),
            distributed.Client(place, timeout=2, security=security) as stranger,
        ):
            stranger.run_on_scheduler(ran.touch)
    assert not ran.exists()
    for said in (b"GET / HTTP/1.1\r\nHost: a\r\n\r\n", b"", b"\x16\x03\x01" + bytes(500)):
        answer = answered(host, int(port), said)
        assert not answer or (answer[0], len(answer)) == (21, 7)  # an alert of TLS
    with pytest.raises(DeviceError, match="nothing answers"):
        Meeting.at(address, other).client()
    own = distributed.Client(address, timeout=10, security=Meeting.at(address, lab).security)
    with own:
        own.run_on_scheduler(ran.touch)
    assert ran.exists()


def answered(host: str, port: int, said: bytes) -> bytes:
    """What a port answers within a moment; TLS answers nothing that is not addressed to it."""
    with socket.create_connection((host, port), 0.3) as connection:
        connection.sendall(said)
        try:
            return connection.recv(100)
        except (TimeoutError, ConnectionResetError):
            return b""


@pytest.mark.whole
def test_joined_workers_measure_and_only_encrypted_ports_are_open_to_others(
    scheduler: tuple[str, subprocess.Popen[bytes]], lab: Path
) -> None:
    address, served = scheduler
    command = [sys.executable, "-m", "fpplab", "cluster", "--workers", "1", "--certificate", str(lab),
               "--join", address]  # fmt: skip
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    with subprocess.Popen(command, cwd=ROOT, env=environment) as joined:
        try:
            workers = DaskWorkers(Formula(noise_um=2.0), scheduler=Meeting.at(address, lab))
            try:
                assert len(measured(workers, TASKS[:2])) == 2
                ports = [p for pid in (served.pid, joined.pid) for p in open_to_others(pid)]
            finally:
                workers.close()
            assert address.removeprefix("tls://") in {f"{host}:{port}" for host, port in ports}
            for host, port in ports:
                with pytest.raises((ssl.SSLError, OSError)):
                    speak_without_a_certificate(host, port)
            joined.send_signal(signal.SIGINT)
            assert joined.wait(30) == 0
        finally:
            joined.kill()


def open_to_others(pid: int) -> list[tuple[str, int]]:
    process = psutil.Process(pid)
    found = [c for p in (process, *process.children(recursive=True)) for c in p.net_connections("inet")]
    ports = [(c.laddr.ip, c.laddr.port) for c in found if c.status == psutil.CONN_LISTEN]
    return [(ip, port) for ip, port in ports if not is_this_computer(ip)]


def speak_without_a_certificate(host: str, port: int) -> None:
    context = ssl.create_default_context()
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with socket.create_connection((host, port), 5.0) as plain, context.wrap_socket(plain) as connection:
        assert not connection.recv(1)  # by the present protocol a refusal comes with the first answer
        raise ConnectionError("it closes at once")
