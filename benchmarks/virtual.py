"""What the benchmarks on the twin know besides the devices: the simulation behind a rig."""

from fpplab.devices.rig import Rig
from sim.bench import VirtualBench


def virtual_bench(rig: Rig) -> VirtualBench:
    """Give the simulation behind an open rig of the twin."""
    assert isinstance(rig.simulation, VirtualBench)  # the benchmark's own rig file says so
    return rig.simulation
