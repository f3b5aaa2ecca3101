"""A person at the emulated bench: does what the operator's fixture asks, without a terminal."""

import sys
from pathlib import Path
from typing import Any

from drivers.emulators.bench import EmulatedBench
from fpplab.devices.operator import Operator


class Person(Operator):
    """Puts up what is asked for; of a board, one of the poses that the optics know after another."""

    def _setup(self, options: dict[str, Any], shared: Any) -> None:
        super()._setup(options, shared)
        assert isinstance(shared, EmulatedBench)
        self._bench, self._taken = shared, 0

    def _open(self) -> None:
        self._hands = self._bench.optics_rig.need_fixture("the rig on it")

    def _mount(self, item: str, pose: int) -> None:
        super()._mount(item, pose)
        self._hands.mount(item, pose)

    def _instruct(self, item: str, description: str, picture: Path | None) -> None:
        super()._instruct(item, description, picture)
        self._hands.mount(item, self._taken % ((self._hands.caps.items or {}).get(item) or 1))
        self._taken += 1

    def _wait_for_answer(self, doing: str, ask: str) -> None:
        sys.stderr.write(f"{ask}, then press Enter: \n")
        sys.stderr.flush()
