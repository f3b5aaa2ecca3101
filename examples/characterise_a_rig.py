"""Camera, projector and the pose between them: `characterise_a_rig.py POSES TARGET OUT.yaml`."""

import sys
from pathlib import Path

from fpplab import Session, Target, characterise_sessions

poses, target, out = sys.argv[1:]
sessions = [Session.open(path) for path in sorted(Path(poses).glob("pose_*"))]
found = characterise_sessions(sessions, Target.load(target))
for name, rms_px in found.calibration.rms_px.items():
    print(f"{name}: {rms_px:.3f} px RMS")
print(f"baseline {found.calibration.baseline_mm:.2f} mm")
found.calibration.save(out)
