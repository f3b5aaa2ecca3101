"""An emulated bench that leaves a note of how it was left: whether it was dark, and the camera disarmed."""

import json
import os
from pathlib import Path

from drivers.emulators.bench import EmulatedBench

NOTE = "FPPLAB_BENCH_NOTE"
"""Environment variable with the file of the note."""


class WitnessedBench(EmulatedBench):
    """Writes the note when it is opened and, once all drivers have let go of it, when it is closed."""

    def open(self) -> None:
        """Open as `EmulatedBench` does."""
        super().open()
        try:
            _write({"open": True})
        except BaseException:  # who opens it does not close what did not open
            super().close()
            raise

    def close(self) -> None:
        """Close as `EmulatedBench` does, after a look at the devices."""
        light = self.controller.light()
        _write(
            {
                "open": False,
                "dark": light is None or not any(light.levels.values()),
                "armed": self.pylon.armed_camera() is not None,
            }
        )
        super().close()


def bench_is_safe(note: Path) -> bool:
    """Tell by its note whether a bench was left safe."""
    if not note.is_file():
        return True
    left = json.loads(note.read_text("utf-8"))
    return bool(left == {"open": False, "dark": True, "armed": False})


def _write(left: dict[str, bool]) -> None:
    Path(os.environ[NOTE]).write_text(json.dumps(left), encoding="utf-8")
