"""Measured point clouds: in memory, in files, and as a surface over the camera's pixel grid."""

from fpplab.clouds.cloud import Cloud, local_quadric_distance
from fpplab.clouds.files import CLOUD_SUFFIXES, READ_SUFFIXES, load_cloud, load_mesh, save_cloud

__all__ = [
    "CLOUD_SUFFIXES",
    "READ_SUFFIXES",
    "Cloud",
    "load_cloud",
    "load_mesh",
    "local_quadric_distance",
    "save_cloud",
]
