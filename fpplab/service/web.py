"""The service's interface over HTTP, and what keeps others out of it."""

from __future__ import annotations

import asyncio
import ipaddress
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from fastapi import Depends, FastAPI, HTTPException, Query, Request
from fastapi.responses import FileResponse, JSONResponse
from fastapi.security import HTTPBearer
from fastapi_offline import FastAPIOffline
from starlette.datastructures import Headers

from fpplab.core.config import validate
from fpplab.core.errors import ConfigError, FppError
from fpplab.core.session_names import CLOUD, REPORT
from fpplab.core.strict_json import parse_object
from fpplab.core.version import __version__
from fpplab.optimisation.cluster import is_this_computer
from fpplab.service.limits import LIMITS
from fpplab.service.order import ScanOrder, ScanStatus
from fpplab.service.state import FOLLOWING, ScanState

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

    from fpplab.service.queue import ScanQueue

FILES = {"cloud": (CLOUD, "application/octet-stream"), "report": (REPORT, "text/html")}
TOO_LARGE = f"an order has {LIMITS.max_body_bytes} bytes at most"
CLOSING = {"connection": "close"}  # or what is left of the body would be read
PUBLIC = ("/docs", "/openapi.json", "/static-offline-docs/")
"""The page that describes the interface: it says nothing of the rig, and asks for the token itself."""


@dataclass(frozen=True)
class Access:
    """Who may ask."""

    token: str
    hosts: frozenset[str]  # names by which the service may be called: others were rebound by somebody's DNS
    clients: tuple[ipaddress.IPv4Network | ipaddress.IPv6Network, ...] = ()  # besides this computer

    def refusal(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        host = _host_of(headers.get("host", ""))
        origin = headers.get("origin")
        if not self._is_client(scope):
            return 403, "this computer is not in the list of --client"
        if host not in self.hosts:
            return 403, f"'{host}' is none of the service's names: give it by --host"
        if origin is not None and origin != f"{scope['scheme']}://{headers.get('host')}":
            return 403, "pages of other sites are not answered"
        if scope["path"].startswith(PUBLIC) and scope["method"] in ("GET", "HEAD"):
            return None
        given = headers.get("authorization", "").removeprefix("Bearer ")
        if not secrets.compare_digest(given.encode(), self.token.encode()):
            return 401, "the token is missing or wrong: send it as 'Authorization: Bearer TOKEN'"
        if int(headers.get("content-length", "0")) > LIMITS.max_body_bytes:
            return 413, TOO_LARGE
        return None

    def _is_client(self, scope: Scope) -> bool:
        if is_local(scope):
            return True
        address = ipaddress.ip_address(scope["client"][0])
        return any(address in network for network in self.clients)


def is_local(scope: Scope) -> bool:
    return scope["client"] is not None and is_this_computer(scope["client"][0])


def _host_of(header: str) -> str:
    """The name in a `Host` header, without its port."""
    name, _, port = header.rpartition(":")
    return (name if name and port.isdecimal() else header).strip("[]").lower()


class Guard:
    """Refuses strangers before anything of their request is read."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return
        taken = 0

        async def bounded() -> Message:
            nonlocal taken
            message = await receive()
            taken += len(message.get("body", b""))
            if taken > LIMITS.max_body_bytes:
                raise HTTPException(413, TOO_LARGE, CLOSING)
            return message

        async def sealed(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [
                    *message["headers"],
                    (b"cache-control", b"no-store"),
                    (b"x-frame-options", b"DENY"),
                    (b"x-content-type-options", b"nosniff"),
                ]
            await send(message)

        refusal = self._access.refusal(scope, Headers(scope=scope))
        if refusal is None:
            await self._app(scope, bounded, sealed)
        else:
            status, sentence = refusal
            await JSONResponse({"error": sentence}, status, CLOSING)(scope, receive, sealed)


class Changes:
    """Wakes requests that wait, in the server's thread, when the queue's thread has changed something."""

    def __init__(self, queue: ScanQueue) -> None:
        self._queue = queue
        self._changed = asyncio.Event()

    def follow(self) -> None:
        loop = asyncio.get_running_loop()
        self._queue.on_change = lambda: loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        self._changed.set()
        self._changed = asyncio.Event()

    async def wait(self, number: int, is_awaited: Callable[[ScanStatus], bool], wait_s: float) -> Any:
        end_s = time.monotonic() + wait_s
        while True:
            changed = self._changed
            status = self._queue.get(number)
            left_s = end_s - time.monotonic()
            if status is None or status.state.has_ended or is_awaited(status) or left_s <= 0:
                return status
            try:
                await asyncio.wait_for(changed.wait(), left_s)
            except TimeoutError:
                continue


def make_app(queue: ScanQueue, access: Access, rig: dict[str, str]) -> tuple[ASGIApp, Changes]:
    app: FastAPI = FastAPIOffline(
        redoc_url=None,
        title="fpplab",
        version=__version__,
        description=f"Scans of {rig['name']}. States follow each other: {', '.join(FOLLOWING)}; or a scan "
        "ends as failed, cancelled or interrupted.",
        dependencies=[Depends(HTTPBearer(auto_error=False))],
    )
    changes = Changes(queue)
    _add_scans(app, queue, changes)

    @app.get("/rig", summary="The rig that is open")
    async def show_rig() -> dict[str, str]:
        return {**rig, "fpplab": __version__}

    @app.exception_handler(FppError)
    async def refuse(_: Request, error: Exception) -> JSONResponse:
        exit_code = getattr(error, "exit_code", 1)
        return JSONResponse({"error": str(error), "exit_code": exit_code}, 422 if exit_code == 2 else 500)

    return Guard(app, access), changes


def _add_scans(app: FastAPI, queue: ScanQueue, changes: Changes) -> None:
    schema = ScanOrder.model_json_schema()
    body = {"requestBody": {"content": {"application/json": {"schema": schema}}, "required": True}}

    @app.post("/scans", status_code=201, openapi_extra=body, summary="Order a scan")
    async def order_scan(request: Request) -> ScanStatus:
        """Put a scan at the end of the queue."""
        order = validate(_order_of(await request.body()), ScanOrder, "order")
        if not is_local(request.scope):
            order.check_remote()
        return queue.accept(order)

    @app.get("/scans", summary="The latest scans, the last one first")
    def list_scans(last: Annotated[int, Query(ge=1, le=LIMITS.max_listed)] = 20) -> list[ScanStatus]:
        return queue.latest(last)

    @app.get("/scans/{number}", summary="How far a scan is", responses={404: {}})
    async def show_scan(
        number: int,
        until: ScanState | None = None,
        after: int | None = None,
        wait_s: Annotated[float, Query(ge=0, le=LIMITS.max_wait_s)] = 0.0,
    ) -> Any:
        """Answer at once, or wait until the scan is so far, or is at another version than `after`."""

        def is_awaited(status: ScanStatus) -> bool:
            is_far = until is not None and status.state.reaches(until)
            return is_far or (after is not None and status.version != after)

        return _known(await changes.wait(number, is_awaited, wait_s))

    @app.delete("/scans/{number}", summary="Cancel a scan that has not ended", responses={404: {}})
    async def cancel_scan(number: int) -> Any:
        queue.cancel(number)
        return _known(queue.get(number))

    @app.get("/scans/{number}/{file}", summary="Its `cloud` or `report`", responses={404: {}})
    async def send_file(number: int, file: str) -> Any:
        status = queue.get(number)
        name, kind = FILES.get(file, ("", ""))
        if status is None or not name or status.state is not ScanState.FINISHED:
            return _unknown()
        path = Path(str(status.out)) / name
        return FileResponse(path, media_type=kind) if path.is_file() else _unknown()


def _order_of(body: bytes) -> dict[str, Any]:
    try:
        return parse_object(body or b"{}")
    except ValueError as error:
        raise ConfigError(f"order: is not JSON ({error})") from error


def _known(status: ScanStatus | None) -> Any:
    return _unknown() if status is None else status


def _unknown() -> JSONResponse:
    return JSONResponse({"error": "there is no such scan, or it has not ended with that"}, 404)
