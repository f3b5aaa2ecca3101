"""Frames -> projector coordinates, with mask and uncertainty."""

from fpplab.phase.decoding import Decoded, Wrapped, decode, wrapped_phase

__all__ = ["Decoded", "Wrapped", "decode", "wrapped_phase"]
