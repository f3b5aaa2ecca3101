"""Accuracy at the limit, each figure beside what theory or exact optics give.

Every part draws its cases anew from fixed seeds and knows their truth from a generator of its own.
"""

from benchmarks import Result
from benchmarks.limit_decoding import decoding_figures
from benchmarks.limit_lattice import lattice_figures
from benchmarks.limit_noise import noise_figures


def run() -> list[Result]:
    """Measure everything; some minutes on two cores."""
    return [*lattice_figures(), *decoding_figures(), *noise_figures()]
