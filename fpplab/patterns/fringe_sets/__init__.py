"""Kinds of fringe sets, one file each; every file of this package is found by itself.

`FringeSet` is what plans, decoding and synchronisation know; `Sinusoid` is the kind of a set that names none.
"""

from fpplab.core.tagged_union import import_members
from fpplab.patterns.fringe_sets.base import Demodulation, FringeSet, indices_along
from fpplab.patterns.fringe_sets.sinusoid import Sinusoid

import_members(__name__, __path__)

__all__ = ["Demodulation", "FringeSet", "Sinusoid", "indices_along"]
