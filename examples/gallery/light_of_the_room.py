"""Lamps of the room as bright as the projector, at an exposure that suits both."""

from bench import plan_of, show

show({"ambient": 0.6}, plan_of(exposure_s=0.01), limit_um=50)
