"""The camera is focused 90 mm in front of the part."""

from bench import show

show({"camera": {"focus_mm": 370}})
