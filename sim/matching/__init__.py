"""Matching of a twin to the bench: the twin's parameters are estimated from a recorded reference."""
