"""What the compiled parts of the decoder share: chunks of pixels, and how functions are compiled."""

import numpy as np

from fpplab.core.compiled import kernel, kernel_part

CHUNK = 2048
"""Pixels whose sums are kept in the cache at a time (chosen). A constant, as the others of the kernels: the
compiler must know distances of rows."""

# Rows lie a little more than a chunk apart: at multiples of a memory page the processor
# takes a row's element for the one it has just stored in another row, and waits.
ROW = CHUNK + 48  # distance between the rows of a working buffer

LOW, HIGH = np.uintp(7 * ROW), np.uintp(8 * ROW)
"""Rows of the buffer of unwrapping with the interval of possible positions."""

# NaN and infinity keep their meaning: only what cannot hide them is relaxed.
_RELAXED = {"contract", "reassoc", "nsz", "arcp"}
compiled = kernel(nogil=True, error_model="numpy", fastmath=_RELAXED)
"""Decorator of every compiled function that works on chunks."""
compiled_part = kernel_part(error_model="numpy", fastmath=_RELAXED)

# Without counting references to arrays, which takes longer than short functions: they make none.
compiled_lean = kernel(nogil=True, error_model="numpy", fastmath=_RELAXED, _nrt=False)
lean_part = kernel_part(error_model="numpy", fastmath=_RELAXED, _nrt=False)
