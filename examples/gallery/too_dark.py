"""A black part at the exposure of a white one."""

from bench import show

show({"material": {"reflectance": 0.03}}, limit_um=100)
