"""A groove of 70 degrees, whose bright walls light each other."""

import trimesh
from bench import show

block = trimesh.creation.box(bounds=[(-45, -30, 440), (45, 30, 490)])
edges = [(-28.0, 440), (0, 480), (28.0, 440)]  # x and depth of the groove, in mm
wedge = trimesh.PointCloud([(x, y, z) for x, z in edges for y in (-31, 31)]).convex_hull
wedge.vertices[wedge.vertices[:, 2] < 441, 2] -= 1  # so that it ends outside of the block

show(
    {"render": {"bounces": 2, "samples": 64, "subpixels": 1}, "material": {"reflectance": 0.95}},
    item="groove",
    shape=trimesh.boolean.difference([block, wedge]),
    limit_um=300,
)
