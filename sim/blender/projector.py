"""The projector: a point light whose colour depends on the direction, through the lens's model.

Every mirror gives the same flux, so a plane square to the axis is lit evenly: the
intensity grows as 1/cos³ of the angle to the axis.
"""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from sim.scene import Lamp


class _Nodes:
    """Writes arithmetic as a node tree."""

    def __init__(self, tree: Any) -> None:
        self.tree = tree

    def add(self, kind: str) -> Any:
        return self.tree.nodes.new(kind)

    def join(self, value: Any, socket: Any) -> None:
        if isinstance(value, float | int):
            socket.default_value = value
        else:
            self.tree.links.new(value, socket)

    def math(self, operation: str, *values: Any) -> Any:
        node = self.add("ShaderNodeMath")
        node.operation = operation
        for value, socket in zip(values, node.inputs, strict=False):
            self.join(value, socket)
        return node.outputs[0]

    def combine(self, kind: str, values: tuple[Any, ...]) -> Any:
        node = self.add(kind)
        for value, socket in zip(values, node.inputs, strict=False):
            self.join(value, socket)
        return node.outputs[0]

    def total(self, *values: Any) -> Any:
        result = values[0]
        for value in values[1:]:
            result = self.math("ADD", result, value)
        return result

    def times(self, *values: Any) -> Any:
        result = values[0]
        for value in values[1:]:
            result = self.math("MULTIPLY", result, value)
        return result


def add_projector(scene: Any, lamp: Lamp, texture: NDArray[np.float32] | None) -> None:
    """The light with `texture` (rows, columns, 3), or without one painting its own coordinates.

    The coordinates are (column, row, 1) in texels: a white light tinted by where it comes from, so that a
    surface it falls on shows where it is lit from and how brightly. Direct light is linear in the tint.
    """
    light = bpy.data.lights.new("projector", "SPOT")
    light.shadow_soft_size, light.spot_blend, light.spot_size = 0.0, 0.0, 2 * lamp.half_angle
    light.energy = 4 * math.pi**2 * lamp.distance_mm**2
    item = bpy.data.objects.new("projector", light)
    # A light looks along -z with y up.
    item.matrix_world = Matrix(lamp.T_camera_projector.tolist()) @ Matrix.Diagonal((1.0, -1.0, -1.0, 1.0))
    scene.collection.objects.link(item)
    light.use_nodes = True
    light.node_tree.nodes.clear()
    nodes = _Nodes(light.node_tree)
    x, y = _slopes(nodes)
    column, row = _texel(nodes, lamp, x, y)
    if texture is None:
        colour = nodes.combine("ShaderNodeCombineColor", (column, row, 1.0))
    else:
        colour = _look_up(nodes, lamp, column, row, texture)
    emission, output = nodes.add("ShaderNodeEmission"), nodes.add("ShaderNodeOutputLight")
    nodes.join(colour, emission.inputs["Color"])
    slope2 = nodes.total(1.0, nodes.times(x, x), nodes.times(y, y))
    nodes.join(nodes.math("POWER", slope2, 1.5), emission.inputs["Strength"])
    nodes.join(emission.outputs[0], output.inputs[0])


def _slopes(nodes: _Nodes) -> tuple[Any, Any]:
    """x/z and y/z in the projector's frame of the lit point; `Normal` points to it in the light's frame."""
    split = nodes.add("ShaderNodeSeparateXYZ")
    nodes.join(nodes.add("ShaderNodeTexCoord").outputs["Normal"], split.inputs[0])
    depth = nodes.times(split.outputs[2], -1.0)
    return nodes.math("DIVIDE", split.outputs[0], depth), nodes.math(
        "DIVIDE", nodes.times(split.outputs[1], -1.0), depth
    )


def _texel(nodes: _Nodes, lamp: Lamp, x: Any, y: Any) -> tuple[Any, Any]:
    """Column and row in the texture: Brown-Conrady, intrinsics and lattice, the last two folded into one."""
    k1, k2, p1, p2, k3 = map(float, lamp.optics.distortion)
    r2 = nodes.total(nodes.times(x, x), nodes.times(y, y))
    radial = nodes.total(
        1.0, nodes.times(r2, nodes.total(k1, nodes.times(r2, nodes.total(k2, nodes.times(r2, k3)))))
    )
    xy2 = nodes.times(x, y, 2.0)
    xd = nodes.total(
        nodes.times(x, radial), nodes.times(xy2, p1), nodes.times(nodes.total(r2, nodes.times(x, x, 2.0)), p2)
    )
    yd = nodes.total(
        nodes.times(y, radial), nodes.times(xy2, p2), nodes.times(nodes.total(r2, nodes.times(y, y, 2.0)), p1)
    )
    to_texel = lamp.affine @ lamp.optics.matrix
    column, row = (
        nodes.total(nodes.times(xd, float(a)), nodes.times(yd, float(b)), float(c)) for a, b, c in to_texel
    )
    return column, row


def _look_up(nodes: _Nodes, lamp: Lamp, column: Any, row: Any, texture: NDArray[np.float32]) -> Any:
    rows, columns = lamp.texture_shape
    image = bpy.data.images.new("pattern", columns, rows, float_buffer=True, is_data=True)
    pixels = np.ones((rows, columns, 4), np.float32)
    pixels[..., :3] = texture[::-1]
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    node = nodes.add("ShaderNodeTexImage")
    node.image, node.extension = image, "CLIP"
    node.interpolation = "Closest" if lamp.exact else "Linear"
    place = (
        nodes.times(nodes.total(column, 0.5), 1.0 / columns),
        nodes.math("SUBTRACT", 1.0, nodes.times(nodes.total(row, 0.5), 1.0 / rows)),
        0.0,
    )
    nodes.join(nodes.combine("ShaderNodeCombineXYZ", place), node.inputs["Vector"])
    return node.outputs["Color"]
