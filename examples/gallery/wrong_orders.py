"""From 1 to 150 stripes in one step, on a grey part: the noise of the coarse set spans many fine fringes."""

from bench import plan_of, show

show({"material": {"reflectance": 0.15}}, plan_of((1, 150), steps=3), limit_um=100)
