"""`python -m benchmarks.crash.board FIRMWARE FLASH …`: the program, with a projector whose flash is a file.

The emulated projector is part of this process, and its flash outlives it: whoever kills the process finds in
the file what was written until then. FIRMWARE is what it was made with, which tells when it starts its
application.
"""

from __future__ import annotations

import mmap
import sys
from pathlib import Path
from typing import cast

from drivers.clock import RealClock
from drivers.dlp4500 import transport
from drivers.dlp4500.transport import HidModule
from drivers.emulators.dlpc350 import EmulatedHid, FlashedDlpc350
from drivers.emulators.dlpc350.flash import SIZE, Flash


class KeptFlash(Flash):
    """A flash memory whose content is a file.

    Parameters
    ----------
    file : Path
        Of `SIZE` bytes.
    """

    def __init__(self, file: Path) -> None:
        with file.open("r+b") as stream:
            self.content = cast(bytearray, mmap.mmap(stream.fileno(), SIZE))


def main() -> None:
    """Run the program of `sys.argv` with the projector."""
    firmware, flash = Path(sys.argv.pop(1)), Path(sys.argv.pop(1))
    board = FlashedDlpc350(RealClock(), firmware.read_bytes())
    board.flash = KeptFlash(flash)
    board.switch_on()
    hid = EmulatedHid(board)
    board.on_restart = hid.leave_bus

    def emulated(name: str) -> HidModule:
        return hid

    vars(transport)["load_hidapi"] = emulated
    from fpplab.__main__ import main as run

    run()


if __name__ == "__main__":
    main()
