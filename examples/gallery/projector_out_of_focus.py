"""The projector is focused 175 mm in front of the part."""

from bench import show

show({"projector": {"focus_mm": 300}}, limit_um=100)
