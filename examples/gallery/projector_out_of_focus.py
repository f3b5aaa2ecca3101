"""The projector is focused 120 mm in front of the part."""

from bench import show

show({"projector": {"focus_mm": 340, "aperture_mm": 8}})
