"""Search for better fringe plans and rig geometry, on a simulation or by measuring on the rig itself."""
