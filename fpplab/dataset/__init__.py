"""Labelled captures over random scenes: made by a simulation, and read again by whoever learns from them."""

from fpplab.dataset.loader import Dataset

__all__ = ["Dataset"]
