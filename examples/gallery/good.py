"""A good scan, shortly after a board has confirmed the calibration."""

from bench import show

show(verified=True)
