"""A client of a service, with nothing but Python's own library."""

from __future__ import annotations

import http.client
import json
import ssl
from pathlib import Path
from typing import Any, Self
from urllib.parse import urlencode, urlsplit

from fpplab.core.errors import ConfigError, DeviceError, FppError
from fpplab.core.strict_json import parse_object
from fpplab.service.limits import LIMITS
from fpplab.service.state import ScanState


class ServiceError(FppError):
    """A service refused an order, or a scan failed there; `exit_code` is that of `fpplab scan`."""

    def __init__(self, fault: dict[str, Any]) -> None:
        super().__init__(str(fault.get("error", "the service refused")))
        self.exit_code = int(fault.get("exit_code", 1))
        self.details = {key: value for key, value in fault.items() if key not in ("error", "exit_code")}


class ServiceClient:
    """Orders scans of a rig that `fpplab serve` keeps open.

    A scan is a dictionary as `GET /scans/NUMBER` gives it: `id`, `state`, `out`, `verdict`, `points`,
    `result` and more. Its states follow each other: `queued`, `running`, `exposed` (the last exposure is
    over: a robot may move on), `judged` (verdict and points are known), `finished`; or it ends as `failed`,
    `cancelled` or `interrupted`.
    """

    MAX_WAIT_S = LIMITS.max_wait_s  # that one request waits

    def __init__(self, url: str, token: str, certificate: Path | str | None = None) -> None:
        parts = urlsplit(url)
        self._secure = parts.scheme == "https"
        if parts.scheme not in ("http", "https") or not parts.hostname or not parts.port:
            raise ConfigError(f"'{url}' is no address of a service: write https://HOST:PORT")
        if self._secure == (certificate is None):
            raise ConfigError(f"'{url}': a certificate belongs to https, and to that alone")
        self.url, self._host, self._port, self._token = url, parts.hostname, parts.port, token
        self._context: ssl.SSLContext | None = None
        if certificate is not None:
            from fpplab.optimisation.cluster import CERTIFICATE

            self._context = ssl.create_default_context(cafile=Path(certificate) / CERTIFICATE)
            self._context.check_hostname = False  # it signs itself: this very one is expected

    @classmethod
    def of_rig(cls, rig: Path | str) -> Self:
        """Find the service that this user has started for a rig on this computer.

        Parameters
        ----------
        rig : path or str
            Rig file, or the name of one that comes with fpplab.

        Returns
        -------
        ServiceClient
            Its client.

        Raises
        ------
        ConfigError
            There is none.
        """
        from fpplab.core.config import find_config

        client = cls.find(find_config(rig, "rig"))
        if client is None:
            raise ConfigError(f"{rig}: no service runs; start one with `fpplab serve --rig {rig}`")
        return client

    @classmethod
    def find(cls, rig_file: Path | str) -> Self | None:
        """Find the service of a rig file; None where no service runs."""
        from fpplab.devices.rig_lock import announced_service

        known = announced_service(rig_file)
        if known is None:
            return None
        certificate = known.get("certificate")
        return cls(str(known["url"]), str(known["token"]), None if certificate is None else str(certificate))

    def order(self, plan: str | dict[str, Any], **options: Any) -> int:
        """Order a scan.

        Parameters
        ----------
        plan : str or dict
            Plan file, the name of one that comes with fpplab, or the plan itself.
        **options
            `calibration`, `out`, `item`, `pose`, `depth_mm`, `limits`, `force`, as `fpplab scan` has them.
            Without them the service's own calibration and the next session of its folder are taken.

        Returns
        -------
        int
            Its number.

        Raises
        ------
        ServiceError
            The order is refused.
        """
        return int(self._ask("POST", "/scans", {"plan": plan, **options})["id"])

    def wait(self, scan: int, until: str = "finished", timeout_s: float | None = None) -> dict[str, Any]:
        """Wait until a scan is so far, or has ended otherwise.

        Parameters
        ----------
        scan : int
            Its number.
        until : str
            A state, such as `exposed`.
        timeout_s : float, optional
            Longest wait in s; by default for ever.

        Returns
        -------
        dict
            The scan.

        Raises
        ------
        DeviceError
            It is not so far in that time, or the service is gone.
        ServiceError
            It failed, was cancelled or interrupted.
        """
        import time

        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        while True:
            left_s = LIMITS.max_wait_s if end_s is None else max(0.0, end_s - time.monotonic())
            status = self.show(scan, until=until, wait_s=min(left_s, LIMITS.max_wait_s))
            state = ScanState(status["state"])
            if state.has_ended and state is not ScanState.FINISHED:
                raise self.fault_of(status)
            if state.reaches(ScanState(until)):
                return status
            if end_s is not None and time.monotonic() >= end_s:
                raise DeviceError(f"scan {scan}", "wait", f"is not {until} within {timeout_s:g} s")

    def show(self, scan: int, **query: Any) -> dict[str, Any]:
        """Ask how far a scan is.

        Parameters
        ----------
        scan : int
            Its number.
        **query
            `until` a state or `after` a version, with `wait_s`: the answer comes then, at the latest after so
            many seconds.

        Returns
        -------
        dict
            The scan.
        """
        return self._ask("GET", f"/scans/{scan}?{urlencode(query)}", wait_s=float(query.get("wait_s", 0.0)))

    def cancel(self, scan: int) -> None:
        """Cancel a scan that has not ended.

        Parameters
        ----------
        scan : int
            Its number.
        """
        self._ask("DELETE", f"/scans/{scan}")

    def save(self, scan: int, file: str, path: Path | str) -> None:
        """Fetch a file of a finished scan.

        Parameters
        ----------
        scan : int
            Its number.
        file : str
            `cloud`, in PLY, or `report`, in HTML.
        path : path or str
            Where it goes.
        """
        from fpplab.core.files import write_atomic

        content = self._exchange("GET", f"/scans/{scan}/{file}")
        write_atomic(Path(path), lambda stream: stream.write(content))

    @staticmethod
    def has_ended(scan: dict[str, Any]) -> bool:
        """Tell whether a scan, as `show` gives it, is finished, failed, cancelled or interrupted."""
        return ScanState(scan["state"]).has_ended

    @staticmethod
    def fault_of(scan: dict[str, Any]) -> ServiceError:
        """Make an error of what a scan, as `show` gives it, ended with."""
        return ServiceError(scan["error"] or {"error": f"scan {scan['id']} is {scan['state']}"})

    def _ask(self, method: str, path: str, body: Any = None, wait_s: float = 0.0) -> dict[str, Any]:
        return parse_object(self._exchange(method, path, body, wait_s))

    def _exchange(self, method: str, path: str, body: Any = None, wait_s: float = 0.0) -> bytes:
        timeout_s = LIMITS.connect_s + wait_s
        connection: http.client.HTTPConnection
        if self._context is not None:
            connection = http.client.HTTPSConnection(
                self._host, self._port, timeout=timeout_s, context=self._context
            )
        else:
            connection = http.client.HTTPConnection(self._host, self._port, timeout=timeout_s)
        headers = {"Authorization": f"Bearer {self._token}", "Connection": "close"}
        sent = None if body is None else json.dumps(body).encode()
        try:
            connection.request(method, path, sent, headers)
            answer = connection.getresponse()
            content = answer.read()
        except (OSError, http.client.HTTPException) as error:
            raise DeviceError(
                f"service at {self.url}", "ask", f"does not answer ({error})", "see whether it still runs"
            ) from error
        finally:
            connection.close()
        if answer.status >= 400:
            try:
                fault = parse_object(content)
            except ValueError:
                fault = {"error": f"{self.url}: answers {answer.status} {answer.reason}"}
            raise ServiceError(fault)
        return content
