"""What surfaces are made of, as Cycles' shaders.

A shader is a body, matt or translucent, under a share of gloss; ridges and grain tilt its normal. Lengths
are mm, because a unit of the scene is one: coordinates of the item's frame are those of its mesh.
"""

from __future__ import annotations

import math
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from fpplab.core.conventions import Floats
from sim.blender.images import float_image
from sim.blender.nodes import Nodes
from sim.scene import POSITION, REFLECTANCE, Grain, Paint, Relief

EDGE = 1.2
"""Edge of a cell of Blender's Voronoi texture for facets of edge 1: a plane through unit cells cuts them into
1.46 facets a unit of area (measured), which makes 1.46 = EDGE² the area of a cell's share."""


def add_paint(mesh: Any, paint: Paint, picture: NDArray[np.uint8] | None, uv: Floats | None) -> None:
    """Make `mesh` of `paint`, printed on with `picture` [v, u] at `uv` (V, 2) of the vertices."""
    material = bpy.data.materials.new("paint")
    material.use_nodes = True
    material.cycles.use_bump_map_correction = False  # it darkens and straightens normals
    tree = material.node_tree
    tree.nodes.clear()
    nodes = Nodes(tree)
    colour: Any = (*[float(_colour(paint, 1.0))] * 3, 1.0)
    if picture is not None and uv is not None:
        colour = _picture(nodes, mesh, _colour(paint, picture / np.float32(255)), uv)
    normal = _normal(nodes, paint)
    shader = _body(nodes, paint, colour, normal)
    if paint.gloss > 0:
        shader = _under_gloss(nodes, paint, shader, normal)
    nodes.join(shader, nodes.add("ShaderNodeOutputMaterial").inputs["Surface"])
    _tell(nodes, POSITION, nodes.add("ShaderNodeNewGeometry").outputs["Position"])
    _tell(nodes, REFLECTANCE, _reflectance(nodes, paint, colour))
    mesh.materials.append(material)


def _tell(nodes: Nodes, name: str, value: Any) -> None:
    output = nodes.add("ShaderNodeOutputAOV")
    output.aov_name = name
    nodes.join(value, output.inputs["Color"])


def _reflectance(nodes: Nodes, paint: Paint, colour: Any) -> Any:
    """Of all layers together, as a grey; the inverse of `_colour`, and what gloss adds."""
    grey = _red(nodes, colour)
    if paint.scatter_mm > 0:
        grey = nodes.times(grey, nodes.total(nodes.times(grey, 0.2), 0.8))
    whole = nodes.total(nodes.times(grey, 1.0 - paint.gloss), paint.gloss)
    return nodes.combine("ShaderNodeCombineColor", (whole, whole, whole))


def _red(nodes: Nodes, colour: Any) -> Any:
    if isinstance(colour, tuple):
        return colour[0]
    split = nodes.add("ShaderNodeSeparateColor")
    nodes.join(colour, split.inputs[0])
    return split.outputs[0]


def _colour(paint: Paint, share: Any) -> Any:
    """Blender's colour for a share of the reflectance.

    They are the same but below a translucent surface: of a colour c Cycles' walk, half of which enters
    refracted and is lost deeper than the colour was fitted for, leaves c (0.8 + 0.2 c) (measured).
    """
    reflectance = paint.ink + (paint.reflectance - paint.ink) * share
    return np.sqrt(4 + 5 * reflectance) - 2 if paint.scatter_mm > 0 else reflectance


def _body(nodes: Nodes, paint: Paint, colour: Any, normal: Any) -> Any:
    """Lambertian, rough, or translucent.

    Rough is Blender 5's Diffuse BSDF: Oren-Nayar as Fujii improved it, and the light that facets pass to each
    other added, as Portsmouth, Kutz and Hill do ("EON: a practical energy-preserving rough diffuse BRDF",
    JCGT 2025), but times the reflectance once more. With white facets no energy is lost.
    Translucent is a random walk of isotropic scattering between entry and exit, the mean free path alike at
    any reflectance; which share of the light is scattered each time follows from the reflectance.
    """
    if paint.scatter_mm == 0:
        body = nodes.add("ShaderNodeBsdfDiffuse")
        nodes.join(paint.roughness, body.inputs["Roughness"])
    else:
        body = nodes.add("ShaderNodeSubsurfaceScattering")
        body.falloff = "RANDOM_WALK"
        # Cycles takes a 4π-th of a radius for the mean free path, so as to look like older models.
        nodes.join(4 * math.pi * paint.scatter_mm, body.inputs["Scale"])
        nodes.join((1.0, 1.0, 1.0), body.inputs["Radius"])
    nodes.join(colour, body.inputs["Color"])
    _tilt(nodes, normal, body)
    return body.outputs[0]


def _under_gloss(nodes: Nodes, paint: Paint, body: Any, normal: Any) -> Any:
    gloss, mixed = nodes.add("ShaderNodeBsdfAnisotropic"), nodes.add("ShaderNodeMixShader")
    gloss.distribution = "GGX"
    nodes.join((1.0, 1.0, 1.0, 1.0), gloss.inputs["Color"])
    nodes.join(paint.gloss_roughness, gloss.inputs["Roughness"])
    _tilt(nodes, normal, gloss)
    for value, socket in zip((paint.gloss, body, gloss.outputs[0]), mixed.inputs, strict=True):
        nodes.join(value, socket)
    return mixed.outputs[0]


def _tilt(nodes: Nodes, normal: Any, shader: Any) -> None:
    if normal is not None:
        nodes.join(normal, shader.inputs["Normal"])


def _normal(nodes: Nodes, paint: Paint) -> Any:
    """The normal of the surface with the heights of ridges and grain on it, or None without any.

    A surface raised by h(X) along its normal n has the normal n - g_t, normalised, where g_t is the part of
    the gradient of h that lies in the surface. An item moves rigidly, so that gradients turn as directions.
    """
    gradients = [*_ridges(nodes, paint.relief), *_facets(nodes, paint.grain)]
    if not gradients:
        return None
    gradient = gradients[0]
    for other in gradients[1:]:
        gradient = nodes.vector("ADD", gradient, other)
    turned = nodes.add("ShaderNodeVectorTransform")
    turned.vector_type, turned.convert_from, turned.convert_to = "VECTOR", "OBJECT", "WORLD"
    nodes.join(gradient, turned.inputs[0])
    slope, flat = turned.outputs[0], nodes.add("ShaderNodeNewGeometry").outputs["Normal"]
    along = nodes.scaled(flat, nodes.dot(flat, slope))
    tilted = nodes.vector("SUBTRACT", flat, nodes.vector("SUBTRACT", slope, along))
    return nodes.vector("NORMALIZE", tilted)


def _ridges(nodes: Nodes, relief: Relief) -> list[Any]:
    """The gradient of `h = depth/2 sin(2π a·X / period)`."""
    if not any(relief.axis) or relief.depth_mm == 0:
        return []
    axis = tuple(map(float, relief.axis))
    wave = 2 * math.pi / relief.period_mm
    phase = nodes.times(nodes.dot(_place(nodes), axis), wave)
    return [nodes.scaled(axis, nodes.times(nodes.math("COSINE", phase), 0.5 * relief.depth_mm * wave))]


def _facets(nodes: Nodes, grain: Grain) -> list[Any]:
    """A gradient of its own for every cell of a random division of space.

    Its components are independent and uniform, of variance slope²/2. Two of them lie in the surface, however
    that is turned, so the root mean square of the gradient's length there is the slope: Sdq of ISO 25178-2.
    """
    if grain.slope == 0:
        return []
    cells = nodes.add("ShaderNodeTexVoronoi")
    cells.voronoi_dimensions, cells.feature = "3D", "F1"
    nodes.join(_place(nodes), cells.inputs["Vector"])
    nodes.join(1.0 / (EDGE * grain.size_mm), cells.inputs["Scale"])
    centred = nodes.vector("SUBTRACT", cells.outputs["Color"], (0.5, 0.5, 0.5))  # of variance 1/12
    return [nodes.scaled(centred, math.sqrt(6.0) * grain.slope)]


def _place(nodes: Nodes) -> Any:
    """The point that is seen, in the item's frame."""
    return nodes.add("ShaderNodeTexCoord").outputs["Object"]


def _picture(nodes: Nodes, mesh: Any, reflectance: NDArray[np.float32], uv: Floats) -> Any:
    """The reflectance [v, u] painted on the mesh."""
    layer = mesh.uv_layers.new(name="picture")
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    upward = np.column_stack([uv[corners, 0], 1.0 - uv[corners, 1]])
    layer.data.foreach_set("uv", upward.ravel().astype(np.float32))
    node = nodes.add("ShaderNodeTexImage")
    node.image, node.interpolation, node.extension = float_image("picture", reflectance), "Linear", "EXTEND"
    return node.outputs["Color"]
