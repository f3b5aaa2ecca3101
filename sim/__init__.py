"""The digital twin: the devices of `fpplab.devices` over one simulated world."""
