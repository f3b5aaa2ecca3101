"""Checks of a rig: what a marker and fringes show of it, and what its devices report."""
