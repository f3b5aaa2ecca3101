"""Limits of a service, each with its reason."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ServiceLimits:
    """What a service takes from its clients, and how long it waits for them."""

    max_body_bytes: int = 1 << 20  # of an order (chosen): a plan is some kilobytes
    max_connections: int = 64  # beyond them the oldest idle one is closed (chosen): scans need handles too
    first_request_s: float = 10.0  # in which a new connection says what it wants (chosen)
    keep_alive_s: int = 5  # in which a connection asks again (uvicorn's own)
    max_wait_s: float = 60.0  # that one request waits for a scan (chosen): proxies end longer ones
    max_queued: int = 1000  # orders that wait (chosen): a day's work
    max_listed: int = 1000  # scans in one answer (chosen): half a megabyte
    max_records: int = 10_000  # latest scans that can be asked for (chosen): weeks, in some hundred megabytes
    closing_s: int = 2  # in which requests are answered when the service ends (chosen)
    switch_interval_s: float = 0.0005  # after which Python lets another thread run: "exposed" is told at once
    connect_s: float = 10.0  # in which a service answers its client, besides what it waits for (chosen)
    progress_step: float = 0.01  # by which progress is told (chosen)


LIMITS = ServiceLimits()
