"""Computers that measure for a search: a dask scheduler and workers.

Whoever reaches one of them has it run any code: without a certificate they listen to this computer alone.
"""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import os
import socket
import ssl
from collections.abc import Iterator
from contextlib import AsyncExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fpplab.core.errors import ConfigError, DeviceError
from fpplab.core.extras import need_extra

CERTIFICATE, KEY = "certificate.pem", "key.pem"
"""Files in the folder of a certificate, the same on each computer."""
HOW_TO = "docs/how-to/several-computers.md says how it is made"


@dataclass(frozen=True)
class SchedulingLimits:
    """Limits of a scheduler and of its workers."""

    connect_timeout_s: float = 10.0  # time that a scheduler may take to answer, and to have a worker (chosen)
    max_worker_deaths: int = 10  # workers that may die of one measurement before it is given up (chosen)


LIMITS = SchedulingLimits()

WORKER_ENVIRONMENT = {
    "MALLOC_ARENA_MAX": 1,
    "MALLOC_MMAP_THRESHOLD_": 32 << 20,
    "MALLOC_TRIM_THRESHOLD_": 1 << 30,
    "PYTHONSAFEPATH": 1,  # no module of the working directory passes for a library
}
"""Environment of a worker. For glibc: freed memory is kept for the next image, which needs as much again.

dask's own setting returns it to the system after every array, so that pages are mapped again half a million
times in each measurement, which takes a third of its time.
"""

ON_LOOPBACK = "127.0.0.1:0"
"""Where dask serves its pages of state: they are not encrypted, and ask nobody who he is."""


@dataclass(frozen=True)
class Meeting:
    """Address of a scheduler, and the certificate with which it is met."""

    protocol: str  # tcp, or tls with a certificate
    host: str
    port: int
    security: Any  # dask's own

    @classmethod
    def at(cls, address: str, certificate: Path | None) -> Meeting:
        """Check an address: nothing beyond this computer is met without a certificate."""
        from distributed import Security

        make_security: Any = Security
        protocol, separator, place = address.rpartition("://")
        protocol = protocol if separator else "tls" if certificate else "tcp"
        host, _, port = place.rpartition(":")
        host = host.removeprefix("[").removesuffix("]")
        if protocol not in ("tcp", "tls") or not host or not port.isdecimal() or int(port) > 65535:
            raise ConfigError(f"'{address}' is no address of a scheduler: write tls://HOST:PORT")
        if certificate is None:
            if not is_this_computer(host):
                raise ConfigError(
                    f"'{address}' is beyond this computer, and whoever reaches it could run code there and "
                    f"here: give --certificate FOLDER, {HOW_TO}"
                )
            if protocol == "tls":
                raise ConfigError(f"'{address}' needs a certificate: give --certificate FOLDER, {HOW_TO}")
            return cls(protocol, host, int(port), make_security(require_encryption=False))
        if protocol != "tls":
            raise ConfigError(f"'{address}' is not encrypted: with --certificate it begins with tls://")
        return cls(protocol, host, int(port), make_security(**_files(certificate)))

    @property
    def address(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{self.protocol}://{host}:{self.port}"

    def client(self) -> Any:
        """Open a client, once a scheduler greets: dask's own waits for ever where something else listens."""
        import distributed

        make_client: Any = distributed.Client
        context: ssl.SSLContext | None = self.security.get_connection_args("client")["ssl_context"]
        try:
            with (
                socket.create_connection((self.host, self.port), LIMITS.connect_timeout_s) as plain,
                context.wrap_socket(plain) if context else plain as connection,
            ):
                if not connection.recv(1):
                    raise OSError("what listens there is no scheduler")
            return make_client(self.address, timeout=LIMITS.connect_timeout_s, security=self.security)
        except OSError as error:
            raise DeviceError(
                "scheduler",
                "connect",
                f"nothing answers at '{self.address}' ({error})",
                "start one with `fpplab cluster`, and give both the same --certificate",
            ) from error


def is_this_computer(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def certificate_files(folder: Path) -> tuple[Path, Path]:
    """Find a certificate that signs itself and its key, loaded to see that they belong together."""
    certificate, key = folder / CERTIFICATE, folder / KEY
    for path in (certificate, key):
        if not path.is_file():
            raise ConfigError(f"{path}: there is no such file; {HOW_TO}")
    if os.name == "posix" and key.stat().st_mode & 0o077:
        raise ConfigError(f"{key}: can be read by other users of this computer; chmod 600 it")
    try:
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=str(certificate))
        context.load_cert_chain(certificate, key)
    except OSError as error:
        raise ConfigError(f"{folder}: its certificate cannot be used ({error}); {HOW_TO}") from error
    return certificate, key


def _files(folder: Path) -> dict[str, object]:
    """Dask's settings for a certificate."""
    certificate, key = certificate_files(folder)
    settings: dict[str, object] = {"tls_ca_file": str(certificate), "require_encryption": True}
    for role in ("client", "scheduler", "worker"):
        settings |= {f"tls_{role}_cert": str(certificate), f"tls_{role}_key": str(key)}
    return settings


@contextmanager
def dask_settings() -> Iterator[None]:
    import dask

    # To start a worker, dask writes its environment into that of this process too, and leaves it there.
    mine = {name: os.environ.get(name) for name in WORKER_ENVIRONMENT}
    settings = {f"distributed.nanny.pre-spawn-environ.{name}": v for name, v in WORKER_ENVIRONMENT.items()}
    settings["distributed.scheduler.allowed-failures"] = LIMITS.max_worker_deaths
    with dask.config.set(settings):
        try:
            yield
        finally:
            _restore_environment(mine)


def _restore_environment(mine: dict[str, str | None]) -> None:
    for name, value in mine.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


def start_processes(workers: int, listen: Meeting | None = None) -> Any:
    import distributed

    library: Any = distributed
    meeting = listen or Meeting.at(ON_LOOPBACK, None)
    return library.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        host=meeting.host,
        scheduler_port=meeting.port,
        protocol=meeting.protocol,
        security=meeting.security,
        dashboard_address=ON_LOOPBACK,
        worker_dashboard_address=ON_LOOPBACK,
        env=_threads_of(workers),
    )


def _threads_of(workers: int) -> dict[str, str]:
    return {"NUMBA_NUM_THREADS": str(max(1, (os.cpu_count() or 1) // max(1, workers)))}


@contextmanager
def serve_scheduler(address: str, certificate: Path | None, workers: int) -> Iterator[str]:
    need_extra("distributed")
    meeting = Meeting.at(address, certificate)
    with dask_settings():
        try:
            cluster = start_processes(workers, meeting)
        except (OSError, RuntimeError) as error:
            reason = error.__cause__ or error
            raise DeviceError("scheduler", "open", f"cannot listen at '{address}' ({reason})") from error
        with cluster:
            yield str(cluster.scheduler_address)


def run_workers(address: str, certificate: Path | None, workers: int) -> None:
    need_extra("distributed")
    meeting = Meeting.at(address, certificate)
    meeting.client().close()
    with dask_settings():
        asyncio.run(_run_workers(meeting, workers))


async def _run_workers(meeting: Meeting, workers: int) -> None:
    import distributed

    library: Any = distributed
    async with AsyncExitStack() as stack:
        nannies = [
            library.Nanny(
                meeting.address,
                nthreads=1,
                security=meeting.security,
                host=library.utils.get_ip(meeting.host),  # by which it is reached from there, not all of them
                silence_logs=logging.ERROR,
                dashboard_address=ON_LOOPBACK,
                env=_threads_of(workers),
            )
            for _ in range(workers)
        ]
        for nanny in nannies:
            await stack.enter_async_context(nanny)
        await asyncio.gather(*(nanny.finished() for nanny in nannies))
