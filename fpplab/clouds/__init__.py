"""Measured points: kept, written, read, and seen as a surface over the pixel grid."""

from fpplab.clouds.cloud import (
    CLOUD_SUFFIXES,
    Cloud,
    load_cloud,
    load_mesh,
    local_quadric_distance,
    save_cloud,
)

__all__ = ["CLOUD_SUFFIXES", "Cloud", "load_cloud", "load_mesh", "local_quadric_distance", "save_cloud"]
