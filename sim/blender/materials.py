"""What surfaces are made of, as Cycles' shaders.

A shader is a base layer, matt or translucent, under a share of gloss; ridges and grain tilt its normal.
Lengths are mm, because a unit of the scene is one: coordinates of the item's frame are those of its mesh.

A new base layer is one function and its line in `BASE_SHADERS`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

import bpy
import numpy as np
from numpy.typing import NDArray

from ..scene import POSITION, REFLECTANCE, Grain, Paint, Relief
from .images import float_image
from .nodes import Nodes

if TYPE_CHECKING:
    from fpplab.core.conventions import Floats

EDGE = 1.2
"""Edge of a cell of Blender's Voronoi texture for facets of edge 1: a plane through unit cells cuts them into
1.46 facets a unit of area (measured), so the area of a cell has to be 1.46 = EDGE²."""

LayerParameters = dict[str, float]  # parameters of a base layer by name, see `sim.scene.BaseLayer`


def _unchanged(reflectance: Any) -> Any:
    return reflectance


def _unchanged_socket(nodes: Nodes, grey: Any) -> Any:
    return grey


class BaseShader(NamedTuple):
    """How a base layer is drawn."""

    node: Callable[[Nodes, LayerParameters], Any]  # adds the shader's node
    colour: Callable[[Any], Any] = _unchanged  # gives Blender's colour for a reflectance
    reflectance: Callable[[Nodes, Any], Any] = _unchanged_socket  # the inverse of `colour`


def _diffuse_shader(nodes: Nodes, parameters: LayerParameters) -> Any:
    """Blender 5's Diffuse BSDF, Lambertian or rough."""
    # Rough is Oren-Nayar as Fujii improved it, and the light that facets pass to each other added, as
    # Portsmouth, Kutz and Hill do ("EON: a practical energy-preserving rough diffuse BRDF", JCGT 2025), but
    # times the reflectance once more. With white facets no energy is lost.
    node = nodes.add("ShaderNodeBsdfDiffuse")
    nodes.join(parameters["roughness"], node.inputs["Roughness"])
    return node


def _translucent_shader(nodes: Nodes, parameters: LayerParameters) -> Any:
    """Random walk of isotropic scattering between entry and exit."""
    # The mean free path is the same at any reflectance; the single-scattering albedo follows from the
    # reflectance.
    node = nodes.add("ShaderNodeSubsurfaceScattering")
    node.falloff = "RANDOM_WALK"
    # Cycles takes a 4π-th of a radius for the mean free path, so as to look like older models.
    nodes.join(4 * math.pi * parameters["radius_mm"], node.inputs["Scale"])
    nodes.join((1.0, 1.0, 1.0), node.inputs["Radius"])
    return node


def _translucent_colour(reflectance: Any) -> Any:
    """Find the colour c whose random walk reflects c (0.8 + 0.2 c) (measured)."""
    # Half of Cycles' walk enters refracted and is lost deeper than the colour was fitted for.
    return np.sqrt(4 + 5 * reflectance) - 2


def _translucent_reflectance(nodes: Nodes, grey: Any) -> Any:
    return nodes.times(grey, nodes.total(nodes.times(grey, 0.2), 0.8))


BASE_SHADERS = {
    "diffuse": BaseShader(_diffuse_shader),
    "translucent": BaseShader(_translucent_shader, _translucent_colour, _translucent_reflectance),
}
"""The shaders of base layers, by the name that `sim.scene.BaseLayer` has for them."""


def add_paint(
    mesh: Any, paint: Paint, picture: NDArray[np.uint8] | None, uv: Floats | None, ambient: float = 0.0
) -> None:
    # uv (V, 2)
    material = bpy.data.materials.new("paint")
    material.use_nodes = True
    material.cycles.use_bump_map_correction = False  # it darkens and straightens normals
    tree = material.node_tree
    tree.nodes.clear()
    nodes = Nodes(tree)
    colour: Any = (*[float(_colour(paint, 1.0))] * 3, 1.0)
    if picture is not None and uv is not None:
        colour = _painted_reflectance(nodes, mesh, _colour(paint, picture / np.float32(255)), uv)
    normal = _normal_with_relief(nodes, paint)
    shader = _base_shader(nodes, paint, colour, normal)
    if paint.gloss > 0:
        shader = _under_gloss(nodes, paint, shader, normal)
    reflectance = _reflectance(nodes, paint, colour)
    if ambient > 0:
        material.cycles.emission_sampling = "NONE"  # otherwise light paths are wasted on it as a lamp
        shader = _under_ambient(nodes, shader, reflectance, ambient)
    nodes.join(shader, nodes.add("ShaderNodeOutputMaterial").inputs["Surface"])
    _output_pass(nodes, POSITION, nodes.add("ShaderNodeNewGeometry").outputs["Position"])
    _output_pass(nodes, REFLECTANCE, reflectance)
    mesh.materials.append(material)


def _output_pass(nodes: Nodes, name: str, value: Any) -> None:
    output = nodes.add("ShaderNodeOutputAOV")
    output.aov_name = name
    nodes.join(value, output.inputs["Color"])


def _reflectance(nodes: Nodes, paint: Paint, colour: Any) -> Any:
    """Grey reflectance of all layers together: the inverse of `_colour`, and what gloss adds."""
    grey = _shader(paint).reflectance(nodes, _red_channel(nodes, colour))
    whole = nodes.total(nodes.times(grey, 1.0 - paint.gloss), paint.gloss)
    return nodes.combine("ShaderNodeCombineColor", (whole, whole, whole))


def _red_channel(nodes: Nodes, colour: Any) -> Any:
    if isinstance(colour, tuple):
        return colour[0]
    split = nodes.add("ShaderNodeSeparateColor")
    nodes.join(colour, split.inputs[0])
    return split.outputs[0]


def _colour(paint: Paint, share: Any) -> Any:
    """Blender's colour where the print has a share of the paint's reflectance, the rest of its ink's."""
    return _shader(paint).colour(paint.ink + (paint.reflectance - paint.ink) * share)


def _base_shader(nodes: Nodes, paint: Paint, colour: Any, normal: Any) -> Any:
    base = _shader(paint).node(nodes, dict(paint.base.parameters))
    nodes.join(colour, base.inputs["Color"])
    _tilt(nodes, normal, base)
    return base.outputs[0]


def _shader(paint: Paint) -> BaseShader:
    name = paint.base.shader
    if name not in BASE_SHADERS:
        raise ValueError(f"there is no shader '{name}'; there are {', '.join(BASE_SHADERS)}")
    return BASE_SHADERS[name]


def _under_gloss(nodes: Nodes, paint: Paint, base: Any, normal: Any) -> Any:
    gloss, mixed = nodes.add("ShaderNodeBsdfAnisotropic"), nodes.add("ShaderNodeMixShader")
    gloss.distribution = "GGX"
    nodes.join((1.0, 1.0, 1.0, 1.0), gloss.inputs["Color"])
    nodes.join(paint.gloss_roughness, gloss.inputs["Roughness"])
    _tilt(nodes, normal, gloss)
    for value, socket in zip((paint.gloss, base, gloss.outputs[0]), mixed.inputs, strict=True):
        nodes.join(value, socket)
    return mixed.outputs[0]


def _under_ambient(nodes: Nodes, shader: Any, reflectance: Any, ambient: float) -> Any:
    """Add what the surface reflects of ambient light, to rays from the camera alone."""
    glow, total = nodes.add("ShaderNodeEmission"), nodes.add("ShaderNodeAddShader")
    nodes.join(reflectance, glow.inputs["Color"])
    from_camera = nodes.add("ShaderNodeLightPath").outputs["Is Camera Ray"]
    nodes.join(nodes.times(from_camera, ambient), glow.inputs["Strength"])
    nodes.join(shader, total.inputs[0])
    nodes.join(glow.outputs[0], total.inputs[1])
    return total.outputs[0]


def _tilt(nodes: Nodes, normal: Any, shader: Any) -> None:
    if normal is not None:
        nodes.join(normal, shader.inputs["Normal"])


def _normal_with_relief(nodes: Nodes, paint: Paint) -> Any:
    """Compute the normal of the surface with ridges and grain on it, None without any."""
    # A surface raised by h(X) along its normal n has the normal n - g_t, normalised, where g_t is the
    # component of the gradient of h tangential to the surface. An item moves rigidly, so gradients turn as
    # directions do.
    gradients = [*_ridge_gradient(nodes, paint.relief), *_facet_gradient(nodes, paint.grain)]
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


def _ridge_gradient(nodes: Nodes, relief: Relief) -> list[Any]:
    """Gradient of `h = depth/2 sin(2π a·X / period)`."""
    if not any(relief.axis) or relief.depth_mm == 0:
        return []
    axis = tuple(map(float, relief.axis))
    wave = 2 * math.pi / relief.period_mm
    phase = nodes.times(nodes.dot(_place(nodes), axis), wave)
    return [nodes.scaled(axis, nodes.times(nodes.math("COSINE", phase), 0.5 * relief.depth_mm * wave))]


def _facet_gradient(nodes: Nodes, grain: Grain) -> list[Any]:
    """Random gradient for every cell of a Voronoi division of space."""
    # Its components are independent and uniform, of variance slope²/2. Two of them lie in the surface,
    # however that is turned, so the root mean square of the gradient's length there is the slope: Sdq of ISO
    # 25178-2.
    if grain.slope == 0:
        return []
    cells = nodes.add("ShaderNodeTexVoronoi")
    cells.voronoi_dimensions, cells.feature = "3D", "F1"
    nodes.join(_place(nodes), cells.inputs["Vector"])
    nodes.join(1.0 / (EDGE * grain.size_mm), cells.inputs["Scale"])
    centred = nodes.vector("SUBTRACT", cells.outputs["Color"], (0.5, 0.5, 0.5))  # of variance 1/12
    return [nodes.scaled(centred, math.sqrt(6.0) * grain.slope)]


def _place(nodes: Nodes) -> Any:
    """Point that is seen, in the item's frame."""
    return nodes.add("ShaderNodeTexCoord").outputs["Object"]


def _painted_reflectance(nodes: Nodes, mesh: Any, reflectance: NDArray[np.float32], uv: Floats) -> Any:
    layer = mesh.uv_layers.new(name="picture")
    corners = np.empty(len(mesh.loops), np.int32)
    mesh.loops.foreach_get("vertex_index", corners)
    upward = np.column_stack([uv[corners, 0], 1.0 - uv[corners, 1]])
    layer.data.foreach_set("uv", upward.ravel().astype(np.float32))
    node = nodes.add("ShaderNodeTexImage")
    node.image, node.interpolation, node.extension = float_image("picture", reflectance), "Linear", "EXTEND"
    return node.outputs["Color"]
