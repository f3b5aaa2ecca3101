"""Phase decoding: frames -> wrapped phase -> projector coordinates, with masks and uncertainty.

`decode` is compiled; a test compares it with the same in plain NumPy.
"""

from fpplab.phase.coded_axes import check_codes
from fpplab.phase.decoded import Decoded
from fpplab.phase.decoding import decode
from fpplab.phase.demodulation import Wrapped, wrapped_phase
from fpplab.phase.drift import PointingDrift
from fpplab.phase.unwrapping import check_unwrapping

__all__ = [
    "Decoded",
    "PointingDrift",
    "Wrapped",
    "check_codes",
    "check_unwrapping",
    "decode",
    "wrapped_phase",
]
