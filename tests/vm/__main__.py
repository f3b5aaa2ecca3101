"""`python -m tests.vm [WORDS FOR PYTEST]`: drivers of USB devices through the kernel of a virtual machine."""

from __future__ import annotations

import sys
import time

from tests.vm.machine import Machine, NotHere

SUITE = (
    *("tests/vm", "tests/conformance/test_life.py", "tests/conformance/test_projector.py"),
    *("tests/conformance/test_camera.py", "--rig", "tests/vm/rig_usb.yaml", "--rig", "tests/vm/rig_uvc.yaml"),
    "-k",
    "not (rig_usb-camera or rig_uvc-projector or (test_camera and rig_usb) or (test_projector and rig_uvc))",
)
"""Each driver on its own rig; the other device of either is not meant."""


def main(words: list[str]) -> int:
    """0 when all passed, 1 when a test failed, 3 when there is no machine to run them in."""
    machine, begin = Machine(), time.monotonic()
    try:
        machine.fetch()
        failed = machine.run(words or SUITE)
    except NotHere as reason:
        sys.stderr.write(f"{reason}\n")
        return 3
    verdict = "FAILED" if failed else "passed"
    sys.stdout.write(f"through a real kernel: {verdict}, {time.monotonic() - begin:.0f} s\n")
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
