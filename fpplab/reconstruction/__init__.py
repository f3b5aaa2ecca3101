"""Reconstruction: triangulation, filtering of flying points, and uncertainty of points."""
