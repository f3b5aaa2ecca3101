"""Does a plan describe its images? Tries the plans next to it, and guesses one from images alone.

Stages: `sample` measures phases and how they change along the image, `edits` are the mistakes that people
make in plans, `check` decides which plan fits, `guess` writes one.
"""

from fpplab.diagnosis.plan.check import PlanCheck, check_plan_fit
from fpplab.diagnosis.plan.code_order import code_order_fault
from fpplab.diagnosis.plan.guess import guess_plan
from fpplab.diagnosis.plan.other_patterns import describe_changing_brightness, name_other_patterns

__all__ = [
    "PlanCheck",
    "check_plan_fit",
    "code_order_fault",
    "describe_changing_brightness",
    "guess_plan",
    "name_other_patterns",
]
