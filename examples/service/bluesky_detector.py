"""A rig as a detector of Bluesky: `bluesky_detector.py TOKEN_FILE PLAN`.

TOKEN_FILE is what a running `fpplab serve --json` names. It needs `pip install bluesky ophyd-async`, and
of fpplab the client alone. A trigger is done when the last exposure is over, so that a plan moves its stages
while the points are computed; reading waits for the verdict.
"""

import asyncio
import json
import sys
import time
from pathlib import Path
from typing import Any

from bluesky import RunEngine
from bluesky.plans import count
from ophyd_async.core import AsyncStatus, StandardReadable

from fpplab import ServiceClient


class FringeProjection(StandardReadable):
    """Verdict, points and the session's folder of each scan."""

    def __init__(self, client: ServiceClient, plan: str, name: str = "fpplab") -> None:
        super().__init__(name=name)
        self._client, self._plan, self._scan = client, plan, 0

    @AsyncStatus.wrap
    async def trigger(self) -> None:
        self._scan = await asyncio.to_thread(self._client.order, self._plan)
        await asyncio.to_thread(self._client.wait, self._scan, "exposed")

    async def describe(self) -> dict[str, Any]:
        kinds = {"verdict": "string", "points": "integer", "session": "string"}
        return {
            f"{self.name}-{key}": {"source": self._client.url, "dtype": kind, "shape": []}
            for key, kind in kinds.items()
        }

    async def read(self) -> dict[str, Any]:
        scan = await asyncio.to_thread(self._client.wait, self._scan, "judged")
        values = {"verdict": scan["verdict"], "points": scan["points"], "session": scan["out"]}
        return {f"{self.name}-{key}": {"value": v, "timestamp": time.time()} for key, v in values.items()}


if __name__ == "__main__":
    service = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    client = ServiceClient(service["url"], service["token"], service["certificate"])
    detector = FringeProjection(client, sys.argv[2])
    RunEngine()(count([detector], num=2), lambda name, document: print(name, document.get("data", "")))
