"""From 1 to 150 stripes in one step: the noise of the coarse set spans several fine fringes."""

from bench import plan_of, show

show({"material": {"reflectance": 0.4}}, plan_of((1, 150), steps=3), limit_um=100)
