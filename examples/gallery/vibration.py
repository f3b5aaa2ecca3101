"""The part moves by 0.05 mm from frame to frame."""

from bench import show

show({"vibration_mm": 0.05}, limit_um=200)
