"""Measured points in the scene, in the colours of their errors."""

from typing import Any

import bpy

from ..nodes import Nodes

COLOURS = "Col"  # name that Blender gives the colours of a PLY file's vertices


def import_cloud(path: str) -> Any:
    """Add the points of a PLY file to the scene of the window, where they were measured."""
    bpy.ops.wm.ply_import(filepath=path, forward_axis="Y", up_axis="Z", import_attributes=True)
    cloud = bpy.context.view_layer.objects.active
    material = _point_colour_material()
    cloud.data.materials.append(material)
    cloud.modifiers.new("points", "NODES").node_group = _sphere_modifier(material)
    return cloud


def _point_colour_material() -> Any:
    """A material that shows the points' own colours in any light."""
    material = bpy.data.materials.new("errors")
    material.use_nodes = True
    material.cycles.emission_sampling = "NONE"
    material.node_tree.nodes.clear()
    nodes = Nodes(material.node_tree)
    colour, glow = nodes.add("ShaderNodeAttribute"), nodes.add("ShaderNodeEmission")
    colour.attribute_name = COLOURS
    nodes.join(colour.outputs["Color"], glow.inputs["Color"])
    nodes.join(glow.outputs[0], nodes.add("ShaderNodeOutputMaterial").inputs["Surface"])
    return material


def _sphere_modifier(material: Any) -> Any:
    group = bpy.data.node_groups.new("points", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    nodes = Nodes(group)
    points, painted = nodes.add("GeometryNodeMeshToPoints"), nodes.add("GeometryNodeSetMaterial")
    points.inputs["Radius"].default_value = 0.15  # mm
    painted.inputs["Material"].default_value = material
    nodes.join(nodes.add("NodeGroupInput").outputs[0], points.inputs[0])
    nodes.join(points.outputs[0], painted.inputs[0])
    nodes.join(painted.outputs[0], nodes.add("NodeGroupOutput").inputs[0])
    return group
