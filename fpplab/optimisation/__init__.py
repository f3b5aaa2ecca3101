"""The search for a better arrangement: on the twin, or by measuring on the rig itself."""
