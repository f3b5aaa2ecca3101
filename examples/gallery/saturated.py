"""Three times too much light."""

from bench import plan_of, show

show(plan=plan_of(exposure_s=0.06))
