"""Decode frames that are NumPy arrays: here of a camera that looks at the projector's own picture."""

import numpy as np

from fpplab import Plan, Recording, decode

WIDTH, HEIGHT = 912, 64
plan = Plan.model_validate(
    {"fringes": tuple({"axis": "x", "stripes": stripes, "steps": 4} for stripes in (1.0, 8.0, 64.0))}
)
column = np.broadcast_to(np.arange(WIDTH), (HEIGHT, WIDTH))
frames = []
for fringes in plan.fringes:
    phase = 2 * np.pi * fringes.stripes * (column + 0.5) / WIDTH
    frames += [np.rint(20 + 200 * fringes.wave(phase, n)).astype(np.uint8) for n in range(fringes.images)]

decoded = decode(Recording(frames, plan, (WIDTH, HEIGHT), name="my frames"))
error_px = np.abs(decoded.u - column)[decoded.valid]
print(f"{decoded.valid.sum()} pixels measured, greatest error {error_px.max():.3f} px")
