"""A projector with a gamma of 2.2, three steps, and no correction."""

from bench import plan_of, show

show({"projector": {"response": {"a": 0.98, "b": 0.02, "g": 2.2}}}, plan_of(steps=3), limit_um=200)
