"""Real instruments, each behind the interface of `fpplab.devices`."""
