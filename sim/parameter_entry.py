"""An entry of the table of parameters that a matching may change; see `sim.parameters`."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class FitRange:
    """How a number is fitted."""

    step: float  # of the finite difference, in the number's unit
    lower: float  # least value that a world accepts
    upper: float  # greatest value that a world accepts
    may_be_at_lower_bound: bool = False  # whether a device may well have the least value


@dataclass(frozen=True)
class ParameterEntry:
    """What is known of a parameter apart from its value."""

    doc: str  # what it is, with its unit
    path: str | None = None  # where a world has it
    fit: FitRange | None = None  # None: not fitted by differences of images; of tuples that of each part
    parts: tuple[str, ...] = ()  # names of the numbers of a tuple
    effect: str | None = None  # parameter that is 0 in a twin without the effect that this one describes
    per_white: bool = False  # whether it is relative to the projector's white, which a + b = 1 makes 1
    reported_at_zero: bool = False  # whether reports list it without the effect, too
    reported_none: str = "sharp at all depths"  # how reports state the value None
    in_binned_px: bool = False  # whether it counts pixels of the frame; a world has those of the sensor


def table_entry(
    doc: str, path: str | None = None, fit: FitRange | None = None, **more: Any
) -> dict[str, ParameterEntry]:
    return {"parameter": ParameterEntry(doc, path, fit, **more)}


@dataclass(frozen=True)
class SubstituteNumber:
    """A number that is fitted in place of a parameter."""

    parameter: str  # its name
    fit: FitRange
    from_parameter: Callable[[float], float]
    to_parameter: Callable[[float], float]
