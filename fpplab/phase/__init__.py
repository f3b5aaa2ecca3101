"""Frames -> projector coordinates, with mask and uncertainty."""

from fpplab.phase.decoding import Decoded, Wrapped, decode, wrapped_phase
from fpplab.phase.unwrapping import check_unwrapping

__all__ = ["Decoded", "Wrapped", "check_unwrapping", "decode", "wrapped_phase"]
