"""The loop of a robot cell: `robot_cell.py RIG PLAN PARTS`, beside a running `fpplab serve --rig RIG`.

The robot moves on as soon as the last exposure is over, and is told the verdict while it puts up the next
part.
"""

import sys

from fpplab import ServiceClient


def move_to(part: int) -> None:
    """Put up a part; your robot's own program stands here."""
    print(f"robot: part {part} in place")


rig, plan, parts = sys.argv[1], sys.argv[2], int(sys.argv[3])
cell, previous = ServiceClient.of_rig(rig), None
for part in range(1, parts + 1):
    move_to(part)
    scan = cell.order(plan)  # the trigger
    if previous is not None:
        print(f"part {part - 1}: {cell.wait(previous)['sentence']}")
    cell.wait(scan, "exposed", timeout_s=60)
    previous = scan
if previous is not None:
    print(f"part {parts}: {cell.wait(previous)['sentence']}")
