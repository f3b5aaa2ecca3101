"""From a session to its error: `reconstruct_and_compare.py SESSION CALIBRATION MESH OUT.png`."""

import sys

from matplotlib import pyplot as plt

from fpplab import Calibration, Session, compare, load_mesh, reconstruct

session, calibration, mesh, out = sys.argv[1:]
known = Calibration.load(calibration)
_, cloud = reconstruct(Session.open(session), known)
found = compare(cloud, load_mesh(mesh), known, align=True)
print(f"{len(cloud.points)} points, {found.surface_smcd_um:.1f} µm mean distance to the true surface")

x, y, _ = cloud.points[found.counted].T
plt.scatter(x, -y, c=1e3 * found.distances_mm[found.counted], s=0.2, cmap="coolwarm", vmin=-50, vmax=50)
plt.colorbar(label="distance, µm")
plt.axis("equal")
plt.savefig(out)
