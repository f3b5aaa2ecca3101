"""Kinds of pattern sets, one file each; every file of this package is found by itself.

Plans, decoding and synchronisation know `PatternSet`; `Sinusoid` is the kind of a set that names none.
"""

from fpplab.core.tagged_union import import_members
from fpplab.patterns.fringe_sets.base import (
    MAX_PATTERN_BITS,
    CodeSet,
    Demodulation,
    FringeSet,
    PatternBits,
    PatternSet,
    indices_along,
)
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid

import_members(__name__, __path__)

__all__ = [
    "MAX_PATTERN_BITS",
    "CodeSet",
    "Demodulation",
    "FringeSet",
    "PatternBits",
    "PatternSet",
    "Sinusoid",
    "indices_along",
]
