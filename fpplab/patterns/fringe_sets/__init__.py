"""Kinds of pattern sets, one file each; every file of this package is found by itself.

Plans, decoding and synchronisation know `PatternSet`, and no module outside this package knows a kind.
"""

from typing import Annotated, Any

from pydantic import TypeAdapter

from fpplab.core.conventions import Axis
from fpplab.core.tagged_union import TaggedUnion, import_members
from fpplab.patterns.fringe_sets.base import (
    MAX_PATTERN_BITS,
    CodeSet,
    Demodulation,
    FringeSet,
    LedName,
    PatternBits,
    PatternSet,
    PeriodicSet,
    SteppedFringes,
    indices_along,
)

import_members(__name__, __path__)

AnySet = Annotated[PatternSet, TaggedUnion(default="sinusoid")]
"""A set of patterns of any kind; a sinusoid where no `kind` is given."""

_any_set: TypeAdapter[PatternSet] = TypeAdapter(AnySet)


def stepped_fringes(axis: Axis, stripes: float, steps: int, **further: Any) -> SteppedFringes:
    """Make the fringe set that a plan has where it names no kind."""
    made = _any_set.validate_python({"axis": axis, "stripes": stripes, "steps": steps, **further})
    assert isinstance(made, SteppedFringes)
    return made


__all__ = [
    "MAX_PATTERN_BITS",
    "AnySet",
    "CodeSet",
    "Demodulation",
    "FringeSet",
    "LedName",
    "PatternBits",
    "PatternSet",
    "PeriodicSet",
    "SteppedFringes",
    "indices_along",
    "stepped_fringes",
]
