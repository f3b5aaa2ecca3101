"""`python -m tests.vm [WORDS FOR PYTEST]`: drivers of USB devices through the kernel of a virtual machine."""

import sys
import time

from tests.vm.machine import Machine, NotHere

CONFORMANCE = [f"tests/conformance/test_{name}.py" for name in ("life", "projector", "camera")]
RIGS = [word for name in ("usb", "uvc") for word in ("--rig", f"tests/vm/rig_{name}.yaml")]
LEFT_OUT = (
    "rig_usb-camera",
    "rig_uvc-projector",
    "(test_camera and rig_usb)",
    "(test_projector and rig_uvc)",
)
SUITE = ("tests/vm", *CONFORMANCE, *RIGS, "-k", f"not ({' or '.join(LEFT_OUT)})")
"""Each driver on its own rig; the other device of either is not meant."""


def main(words: list[str]) -> int:
    """0 when all passed, 1 when a test failed, 3 when there is no machine to run them in."""
    machine, begin = Machine(), time.monotonic()
    try:
        machine.fetch()
        failed = machine.compile() or machine.run(words or SUITE)
    except NotHere as reason:
        sys.stderr.write(f"{reason}\n")
        return 3
    verdict = "FAILED" if failed else "passed"
    sys.stdout.write(f"through a real kernel: {verdict}, {time.monotonic() - begin:.0f} s\n")
    return failed


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
