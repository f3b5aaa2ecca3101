"""Edges, with the filter switched off: pixels that see two surfaces lie between them."""

from bench import plan_of, show

show({"camera": {"focus_mm": 430}}, plan_of(filter=None), item="pillars", limit_um=300)
