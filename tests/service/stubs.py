"""An instrument that measures nothing, and its service on the loopback interface."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from fpplab.results.observer import Observer
from fpplab.service.client import ServiceClient
from fpplab.service.queue import ScanQueue
from fpplab.service.serving import ServiceAddress, serving

TOKEN = "t" * 40


class Bench:
    """Does to the observer what a scan would."""

    def __init__(self, folder: Path, scan: Callable[[Observer], object] = lambda observer: None) -> None:
        self.rig: Any = SimpleNamespace(source=str(folder / "rig.yaml"), file=SimpleNamespace(name="Stub"))
        self.folder, self.scan = folder, scan

    def next_session(self) -> Path:
        return self.folder / "scan_0001"

    def run_order(self, order: object, out: Path, observer: Observer) -> Any:
        with observer.stage("Scanning") as progress:
            progress(0.5)
            observer.exposed()
        self.scan(observer)
        verdict = SimpleNamespace(is_useless=False, sentence="good", verdict=SimpleNamespace(value="good"))
        result = SimpleNamespace(diagnosis=verdict, cloud=[1, 2], summary=lambda: {"points": 2, "cloud": "x"})
        observer.result(result)
        return result


class Orders(ScanQueue):
    """A queue of that instrument."""

    def __init__(self, bench: Bench, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        super().__init__(bench, folder)  # type: ignore[arg-type]


@contextmanager
def served(queue: ScanQueue, bench: Bench, **address: Any) -> Iterator[ServiceClient]:
    with serving(queue, bench.rig, ServiceAddress(**address), TOKEN) as where:
        yield ServiceClient(where["url"], TOKEN, address.get("certificate"))
