"""Serving: the address, who may reach it, the token, and where this user's commands find it."""

from __future__ import annotations

import asyncio
import ipaddress
import os
import secrets
import socket
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from fpplab.core.errors import ConfigError
from fpplab.devices.rig_lock import announcing_service
from fpplab.optimisation.cluster import certificate_files, is_this_computer
from fpplab.service.limits import LIMITS
from fpplab.service.web import Access, make_app

if TYPE_CHECKING:
    from fpplab.devices.rig import Rig
    from fpplab.service.queue import ScanQueue

MIN_TOKEN = 32  # characters of a token that cannot be guessed (chosen): 128 bits and more


@dataclass(frozen=True)
class ServiceAddress:
    """Where a service listens, and to whom."""

    host: str = "127.0.0.1"
    port: int = 0  # any that is free
    certificate: Path | None = None  # folder of certificate.pem and key.pem
    names: tuple[str, ...] = ()  # by which other computers call it, besides the address
    clients: tuple[str, ...] = ()  # addresses or networks of other computers

    @classmethod
    def parse(
        cls, listen: str, certificate: Path | None, names: list[str], clients: list[str]
    ) -> ServiceAddress:
        host, _, port = listen.rpartition(":")
        host = host.strip("[]")
        if not host or not port.isdecimal() or int(port) > 65535:
            raise ConfigError(f"--listen '{listen}': is no address; write HOST:PORT, such as 127.0.0.1:8787")
        if not is_this_computer(host) and (certificate is None or not clients):
            raise ConfigError(
                f"--listen '{listen}': is beyond this computer: give --certificate FOLDER, and by --client "
                "which computers may ask"
            )
        return cls(host, int(port), certificate, tuple(names), tuple(clients))

    def access(self, token: str) -> Access:
        hosts = {"127.0.0.1", "localhost", "::1", self.host.lower(), *(name.lower() for name in self.names)}
        try:
            networks = tuple(ipaddress.ip_network(client) for client in self.clients)
        except ValueError as error:
            raise ConfigError(f"--client: {error}; write an address or a network, 192.168.1.0/24") from error
        return Access(token, frozenset(hosts), networks)

    def bind(self) -> socket.socket:
        family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
        try:
            return socket.create_server((self.host, self.port), family=family, backlog=LIMITS.max_connections)
        except OSError as error:
            raise ConfigError(
                f"--listen '{self.host}:{self.port}': cannot be used ({error.strerror})"
            ) from error


class BoundedConnections(H11Protocol):
    """A connection: there are so many at most, and each asks for something soon."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        idle = [each for each in self.connections if each.cycle is None or each.cycle.response_complete]  # type: ignore[union-attr]
        if len(self.connections) >= LIMITS.max_connections:
            if not idle:
                transport.abort()
                return
            idle[0].transport.abort()
            self.connections.discard(idle[0])
        super().connection_made(transport)
        self.loop.call_later(LIMITS.first_request_s, self._end_silent)

    def _end_silent(self) -> None:
        if self.cycle is None:
            self.transport.abort()


def make_token(file: Path | None) -> str:
    """Read the token of a file that its user alone can read, or make a new one."""
    if file is None:
        return secrets.token_urlsafe(MIN_TOKEN)
    try:
        if os.name == "posix" and file.stat().st_mode & 0o077:
            raise ConfigError(f"{file}: can be read by other users of this computer; chmod 600 it")
        token = file.read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{file}: cannot be read as a token ({error})") from error
    if len(token) < MIN_TOKEN or not token.isprintable() or " " in token:
        raise ConfigError(f"{file}: a token is one word of {MIN_TOKEN} characters or more")
    return token


@contextmanager
def serving(queue: ScanQueue, rig: Rig, address: ServiceAddress, token: str) -> Iterator[dict[str, Any]]:
    """Answer requests in a thread of their own; gives what commands of this user find of it."""
    app, changes = make_app(queue, address.access(token), {"name": rig.file.name, "file": rig.source})
    tls: dict[str, Any] = {}
    if address.certificate is not None:
        certificate, key = certificate_files(address.certificate)
        tls = {"ssl_certfile": str(certificate), "ssl_keyfile": str(key)}
    config = uvicorn.Config(
        app,
        http=BoundedConnections,
        ws="none",
        lifespan="off",
        log_config=None,
        access_log=False,
        proxy_headers=False,  # or anybody could pass for this computer
        server_header=False,
        timeout_keep_alive=LIMITS.keep_alive_s,
        timeout_graceful_shutdown=LIMITS.closing_s,
        **tls,
    )
    listening = address.bind()
    shown = f"[{address.host}]" if ":" in address.host else address.host
    url = f"{'https' if tls else 'http'}://{shown}:{listening.getsockname()[1]}"
    folder = str(address.certificate.resolve()) if address.certificate else None
    announcement = {"url": url, "pid": os.getpid(), "token": token, "certificate": folder}
    server, started = uvicorn.Server(config), threading.Event()

    async def serve() -> None:
        changes.follow()
        started.set()
        await server.serve([listening])

    thread = threading.Thread(target=lambda: asyncio.run(serve()), name="service", daemon=True)
    sys.setswitchinterval(LIMITS.switch_interval_s)
    with listening, announcing_service(rig.source, announcement) as place:
        thread.start()
        started.wait()
        try:
            yield {"url": url, "pid": os.getpid(), "token_file": str(place)}
        finally:
            server.should_exit = True
            thread.join(2.0 * LIMITS.closing_s)
