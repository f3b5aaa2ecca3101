"""Daylight half as bright as the projector."""

from bench import show

show({"ambient": 0.6}, limit_um=50)
