"""`python -P board.py FIRMWARE FLASH …`: the program, with a projector whose flash is a file.

The emulated projector is part of this process, and its flash outlives it: whoever kills the process finds in
the file what was written until then. FIRMWARE is what it was made with, which tells when it starts its
application. As in the program itself nothing is loaded before signals are heard; as a module of its package
this file would come after all of the benchmark.
"""

import sys

from fpplab.__main__ import hear_signals
from fpplab.__main__ import main as run


def main() -> None:
    """Run the program of `sys.argv` with the projector."""
    hear_signals()
    import mmap
    from pathlib import Path
    from typing import cast

    from drivers.clock import RealClock
    from drivers.dlp4500 import transport
    from drivers.emulators.dlpc350 import EmulatedHid, FlashedDlpc350
    from drivers.emulators.dlpc350.flash import SIZE

    firmware, flash = Path(sys.argv.pop(1)), Path(sys.argv.pop(1))
    board = FlashedDlpc350(RealClock(), firmware.read_bytes())
    with flash.open("r+b") as stream:
        board.flash.content = cast(bytearray, mmap.mmap(stream.fileno(), SIZE))
    board.switch_on()
    hid = EmulatedHid(board)
    board.on_restart = hid.leave_bus

    def emulated(name: str) -> transport.HidModule:
        return hid

    vars(transport)["load_hidapi"] = emulated
    run()


if __name__ == "__main__":
    main()
