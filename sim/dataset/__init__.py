"""Labelled captures of random scenes for training: made with a simulation, and read by `Dataset`."""

from sim.dataset.loader import Dataset

__all__ = ["Dataset"]
