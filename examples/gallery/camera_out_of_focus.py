"""The camera is focused 120 mm in front of the part."""

from bench import show

show({"camera": {"focus_mm": 330}, "render": {"subpixels": 4}}, item="pillars", limit_um=100)
