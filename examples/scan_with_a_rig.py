"""Measure one item with the devices of a rig file: `scan_with_a_rig.py RIG CALIBRATION ITEM OUT`."""

import sys

from fpplab import Calibration, Plan, Rig, scan

rig_file, calibration, item, out = sys.argv[1:]
with Rig.load(rig_file) as rig:
    result = scan(rig, Plan.load("plan_paper"), Calibration.load(calibration), out, (item, 0))
print(f"{len(result.cloud.points)} points in {out}/cloud.ply; {result.diagnosis.sentence}")
