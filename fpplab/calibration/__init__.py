"""Calibrations: both devices' camera models and the pose between them, and conversion from and to OpenCV."""
