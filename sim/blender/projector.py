"""The projector: a point light whose colour depends on the direction, through the lens's model.

Every mirror gives the same flux, so a plane perpendicular to the axis is illuminated uniformly: the
intensity grows as 1/cos³ of the angle to the axis.
"""

import math
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix
from numpy.typing import NDArray

from ..scene import Lamp
from .images import float_image
from .nodes import Nodes


def add_projector(scene: Any, lamp: Lamp, textures: NDArray[np.float32] | None) -> None:
    # textures (circles, rows, columns)
    light = bpy.data.lights.new("projector", "SPOT")
    light.shadow_soft_size, light.spot_blend, light.spot_size = 0.0, 0.0, 2 * lamp.half_angle
    light.energy = 4 * math.pi**2 * lamp.distance_mm**2
    item = bpy.data.objects.new("projector", light)
    # A light looks along -z with y up.
    item.matrix_world = Matrix(lamp.T_camera_projector.tolist()) @ Matrix.Diagonal((1.0, -1.0, -1.0, 1.0))
    scene.collection.objects.link(item)
    light.use_nodes = True
    light.node_tree.nodes.clear()
    nodes = Nodes(light.node_tree)
    x, y, cosine = _direction_from_projector(nodes)
    emission, output = nodes.add("ShaderNodeEmission"), nodes.add("ShaderNodeOutputLight")
    if textures is not None:
        column, row = _mirror_column_row(nodes, lamp, x, y)
        nodes.join(_mix_textures(nodes, lamp, column, row, cosine, textures), emission.inputs["Color"])
    slope2 = nodes.total(1.0, nodes.times(x, x), nodes.times(y, y))
    nodes.join(nodes.math("POWER", slope2, 1.5), emission.inputs["Strength"])
    nodes.join(emission.outputs[0], output.inputs[0])


def _direction_from_projector(nodes: Nodes) -> tuple[Any, Any, Any]:
    """Slopes x/z and y/z of the illuminated point in the projector's frame, and cosine to the axis."""
    # The texture coordinate `Normal` points to it in the light's frame.
    split = nodes.add("ShaderNodeSeparateXYZ")
    nodes.join(nodes.add("ShaderNodeTexCoord").outputs["Normal"], split.inputs[0])
    depth = nodes.times(split.outputs[2], -1.0)
    x, y = (
        nodes.math("DIVIDE", across, depth)
        for across in (split.outputs[0], nodes.times(split.outputs[1], -1.0))
    )
    return x, y, depth


def _mirror_column_row(nodes: Nodes, lamp: Lamp, x: Any, y: Any) -> tuple[Any, Any]:
    """Column and row of mirrors: lens distortion, then intrinsics and lattice as one affine map."""
    k1, k2, p1, p2, k3, k4, k5, k6 = map(float, lamp.optics.distortion)
    r2 = nodes.total(nodes.times(x, x), nodes.times(y, y))
    radial = nodes.math(
        "DIVIDE", _one_and_powers(nodes, r2, k1, k2, k3), _one_and_powers(nodes, r2, k4, k5, k6)
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


def _one_and_powers(nodes: Nodes, x: Any, a: float, b: float, c: float) -> Any:
    """1 + a x + b x² + c x³."""
    return nodes.total(1.0, nodes.times(x, nodes.total(a, nodes.times(x, nodes.total(b, nodes.times(x, c))))))


def _mix_textures(
    nodes: Nodes, lamp: Lamp, column: Any, row: Any, cosine: Any, textures: NDArray[np.float32]
) -> Any:
    """Mix the textures at one place for the circle of confusion at the illuminated point's depth."""
    colour = _look_up(nodes, lamp, column, row, textures[0])
    if len(lamp.circles) == 1:
        return colour
    squares = [circle**2 for circle in lamp.circles]
    square = _circle_squared(nodes, lamp, cosine)
    for texture, low, high in zip(textures[1:], squares[:-1], squares[1:], strict=True):
        share = nodes.times(nodes.math("SUBTRACT", square, low), 1.0 / (high - low))
        mix = nodes.add("ShaderNodeMix")
        mix.data_type, mix.clamp_factor = "RGBA", True
        nodes.join(share, mix.inputs["Factor"])
        nodes.join(colour, _colour_socket(mix, "A"))
        nodes.join(_look_up(nodes, lamp, column, row, texture), _colour_socket(mix, "B"))
        colour = next(s for s in mix.outputs if s.type == "RGBA")
    return colour


def _colour_socket(mix: Any, name: str) -> Any:
    return next(s for s in mix.inputs if s.name == name and s.type == "RGBA")


def _circle_squared(nodes: Nodes, lamp: Lamp, cosine: Any) -> Any:
    """Square of the circle of confusion's diameter, in texels."""
    distance = nodes.add("ShaderNodeLightPath").outputs["Ray Length"]
    inverse = nodes.math("DIVIDE", 1.0, nodes.times(distance, cosine))
    scale = lamp.texels_per_slope * lamp.aperture.diameter_mm
    circle = nodes.times(nodes.math("SUBTRACT", inverse, 1.0 / lamp.aperture.focus_mm), scale)
    return nodes.times(circle, circle)


def _look_up(nodes: Nodes, lamp: Lamp, column: Any, row: Any, texture: NDArray[np.float32]) -> Any:
    node = nodes.add("ShaderNodeTexImage")
    node.image, node.extension = float_image("pattern", texture), "CLIP"
    node.interpolation = "Closest" if lamp.exact else "Cubic"
    (rows, columns), fine = lamp.texture_shape, lamp.places_per_mirror
    place = (
        nodes.times(nodes.total(nodes.times(column, float(fine)), 0.5), 1.0 / columns),
        nodes.math("SUBTRACT", 1.0, nodes.times(nodes.total(nodes.times(row, float(fine)), 0.5), 1.0 / rows)),
        0.0,
    )
    nodes.join(nodes.combine("ShaderNodeCombineXYZ", place), node.inputs["Vector"])
    if not lamp.exact or lamp.fill == 1:
        return node.outputs["Color"]
    return _within_mirror(nodes, lamp, column, row, node.outputs["Color"])


def _within_mirror(nodes: Nodes, lamp: Lamp, column: Any, row: Any, colour: Any) -> Any:
    """Darken the gaps between mirrors that do not fill their squares, without changing the mean."""
    scale = 1.0 / lamp.fill**2
    for place in (column, row):
        from_centre = nodes.math("ABSOLUTE", nodes.math("SUBTRACT", place, nodes.math("ROUND", place)))
        scale = nodes.times(nodes.math("LESS_THAN", from_centre, lamp.fill / 2), scale)
    return nodes.scaled(colour, scale)
