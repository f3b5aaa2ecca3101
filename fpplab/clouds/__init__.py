"""Measured point clouds: in memory, in files, and as a surface over the camera's pixel grid."""

from fpplab.clouds.cloud import (
    CLOUD_SUFFIXES,
    Cloud,
    load_cloud,
    load_mesh,
    local_quadric_distance,
    save_cloud,
)

__all__ = ["CLOUD_SUFFIXES", "Cloud", "load_cloud", "load_mesh", "local_quadric_distance", "save_cloud"]
