"""Printed parts: volumes, staircases and wall marks that are known exactly."""

import re
from pathlib import Path

import igl
import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from fpplab import artefacts
from fpplab.artefacts import layer_count, load_part, slice_as_printed
from fpplab.core.errors import ConfigError

BEAD = 0.03
LAYER = 0.2


def box(width: float, depth: float, height: float, x: float = 0.0, z: float = 0.0) -> trimesh.Trimesh:
    """A box that stands on z, centred on x and y = 0."""
    return trimesh.creation.box((width, depth, height)).apply_translation([x, 0.0, z + height / 2])


def pyramid_of_45_degrees(height: float) -> trimesh.Trimesh:
    """Square, without plate or top: z = height - max(|x|, |y|)."""
    h = height
    corners = np.array([(-h, -h, 0), (h, -h, 0), (h, h, 0), (-h, h, 0), (0, 0, h)], float)
    faces = [(0, 2, 1), (0, 3, 2), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4)]
    return trimesh.Trimesh(corners, faces)


def frame() -> trimesh.Trimesh:
    """A square tube: 20 mm wide outside, 10 mm inside, 2 mm high."""
    return trimesh.boolean.difference([box(20, 20, 2), box(10, 10, 4, z=-1)], engine="manifold")


def sheared() -> trimesh.Trimesh:
    """A plate 1 mm thick that leans by 3 mm per mm of height."""
    mesh = box(1, 5, 4)
    mesh.vertices[:, 0] += 3 * mesh.vertices[:, 2]
    return mesh


def turned_inwards() -> trimesh.Trimesh:
    mesh = box(2, 2, 2)
    mesh.invert()
    return mesh


def without_a_face() -> trimesh.Trimesh:
    mesh = box(2, 2, 2)
    return trimesh.Trimesh(mesh.vertices, mesh.faces[1:])


def assert_one_solid(mesh: trimesh.Trimesh) -> None:
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.body_count == 1
    assert mesh.volume > 0


def distances(points: np.ndarray, mesh: trimesh.Trimesh) -> np.ndarray:
    squared = igl.point_mesh_squared_distance(
        np.asarray(points), np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int64)
    )[0]
    return np.sqrt(squared)


def width_at(mesh: trimesh.Trimesh, z: float) -> float:
    return float(mesh.section(plane_origin=[0, 0, z], plane_normal=[0, 0, 1]).extents[0])


@given(height=st.floats(1.0, 30.0), layer=st.floats(0.05, 1.0), width=st.floats(1.0, 90.0))
def test_a_box_stays_a_box_of_whole_layers(height: float, layer: float, width: float) -> None:
    mesh = slice_as_printed(box(width, 10.0, height), layer)
    printed = layer_count(height, layer) * layer
    assert abs(printed - height) <= layer / 2 + 1e-4
    assert mesh.volume == pytest.approx(width * 10.0 * printed, rel=1e-6)
    assert len(mesh.faces) == 12
    assert_one_solid(mesh)


@pytest.mark.parametrize(
    ("height", "layers"), [(2.0, 10), (2.09, 10), (2.1, 10), (2.11, 11), (0.11, 1), (400.0, 2000)]
)
def test_height_is_rounded_to_whole_layers_half_a_layer_down(height: float, layers: int) -> None:
    assert layer_count(height, LAYER) == layers


def test_a_slope_of_45_degrees_is_the_sum_of_its_cross_sections() -> None:
    mesh = slice_as_printed(pyramid_of_45_degrees(10.0), LAYER)
    middles = LAYER * (np.arange(50) + 0.5)
    assert mesh.volume == pytest.approx(LAYER * np.sum((2 * (10.0 - middles)) ** 2), rel=1e-5)
    assert_one_solid(mesh)


def test_corners_of_a_staircase_are_half_a_layer_off() -> None:
    drawn = pyramid_of_45_degrees(10.0)
    mesh = slice_as_printed(drawn, LAYER)
    nominal = 10.0 - np.abs(mesh.vertices[:, :2]).max(axis=1)
    assert np.abs(mesh.vertices[:, 2] - nominal) == pytest.approx(LAYER / 2, abs=1e-4)
    middles = LAYER * (np.arange(1, 50) + 0.5)
    for edge in (middles - LAYER / 2, middles + LAYER / 2):  # the noses and the roots, seen from the side
        stairs = np.stack([10.0 - middles, np.zeros(49), edge], axis=1)
        assert distances(stairs, mesh) == pytest.approx(0.0, abs=1e-4)
        assert distances(stairs, drawn) == pytest.approx(LAYER / 2 * np.cos(np.pi / 4), abs=1e-9)


@pytest.mark.whole_after(1)
@pytest.mark.parametrize(("layer", "bead"), [(LAYER, 0.0), (2.0, 0.2)])
@pytest.mark.parametrize("name", artefacts.NAMES)
def test_artefacts_are_one_solid_close_to_the_drawn_one(
    tmp_path: Path, name: str, layer: float, bead: float
) -> None:
    nominal = artefacts.make(name)
    mesh = slice_as_printed(nominal, layer, bead)
    assert_one_solid(mesh)
    # In height a layer is off by half of itself at most, across a wall by the marks.
    assert distances(mesh.vertices, nominal).max() <= np.hypot(layer / 2, bead * np.sqrt(2)) + 1e-4
    artefacts.save_stl(mesh, tmp_path / "printed.stl")
    read = load_part(tmp_path / "printed.stl")
    assert len(read.faces) == len(mesh.faces)
    assert read.volume == pytest.approx(mesh.volume, rel=1e-6)


@pytest.mark.parametrize("name", ["pyramid", "steps"])
def test_artefacts_take_marks_at_a_layer_of_a_real_printer(name: str) -> None:
    assert_one_solid(slice_as_printed(artefacts.make(name), LAYER, BEAD))


def test_plain_walls_stay_as_drawn() -> None:
    mesh = slice_as_printed(artefacts.make("steps"), LAYER)
    assert mesh.volume == pytest.approx(artefacts.make("steps").volume, rel=1e-9)
    assert set(np.round(mesh.vertices[:, 2], 9)) == {0, 5, 10, 15, 20, 25}


def test_a_face_in_the_middle_of_a_layer_is_rounded_down() -> None:
    mesh = slice_as_printed(artefacts.make("steps"), 0.4)
    assert set(np.round(mesh.vertices[:, 2], 9)) == {0, 4.8, 10, 14.8, 20, 24.8}


def test_marks_on_a_wall_have_the_stated_depth_and_a_round_profile() -> None:
    mesh = slice_as_printed(box(20, 10, 2), LAYER, BEAD)
    assert_one_solid(mesh)
    radius = ((LAYER / 2) ** 2 + BEAD**2) / (2 * BEAD)
    for k in range(10):
        for height in np.linspace(0.001, LAYER - 0.001, 23):
            depth = (20.0 - width_at(mesh, k * LAYER + height)) / 2
            arc = radius - np.sqrt(radius**2 - (height - LAYER / 2) ** 2)
            assert depth == pytest.approx(arc, abs=BEAD / 4 + 1e-6)
        assert width_at(mesh, (k + 0.5) * LAYER) == pytest.approx(20.0, abs=1e-7)
        assert width_at(mesh, k * LAYER + 0.001) == pytest.approx(20.0 - 2 * BEAD, abs=1e-7)
        assert width_at(mesh, (k + 1) * LAYER - 0.001) == pytest.approx(20.0 - 2 * BEAD, abs=1e-7)


def test_marks_go_into_the_material_on_the_walls_of_a_hole() -> None:
    mesh = slice_as_printed(frame(), LAYER, BEAD)
    assert mesh.is_watertight
    inner = np.abs(mesh.vertices[np.abs(mesh.vertices[:, :2]).max(axis=1) < 6, :2]).max(axis=1)
    assert inner.min() == pytest.approx(5.0, abs=1e-7)
    assert inner.max() == pytest.approx(5.0 + BEAD, abs=1e-7)


def test_a_hollow_stays_a_hollow() -> None:
    hollow = trimesh.boolean.difference([box(10, 10, 10), box(4, 4, 4, z=3)], engine="manifold")
    mesh = slice_as_printed(hollow, LAYER)
    assert mesh.is_watertight
    assert mesh.volume == pytest.approx(1000.0 - 64.0, rel=1e-9)


@pytest.mark.parametrize(
    ("mesh", "layer", "bead", "sentence"),
    [
        (box(2, 2, 2), 0.0, 0.0, "layer_mm: 0 mm must be above 0 mm"),
        (box(2, 2, 2), -0.2, 0.0, "layer_mm: -0.2 mm must be above 0 mm"),
        (box(2, 2, 2), float("nan"), 0.0, "layer_mm: nan mm must be above 0 mm"),
        (box(2, 2, 2), float("inf"), 0.0, "layer_mm: inf mm must be above 0 mm"),
        (box(2, 2, 2), 4.0, 0.0, "must be less than twice the part's height, 2 mm"),
        (box(2, 2, 2), 0.0005, 0.0, "more than 2000 layers of 2 mm; give at least 0.001 mm"),
        (box(2, 2, 2), 0.2, -0.01, "bead_mm: -0.01 mm must be from 0"),
        (box(2, 2, 2), 0.2, 0.1, "less than half a layer, 0.1 mm"),
        (box(2, 2, 2), 0.2, float("nan"), "bead_mm: nan mm must be from 0"),
        (box(0.05, 2, 2), 0.2, 0.03, "half of a feature's width or more at z = 0.1 mm; give less"),
        (box(2, 2, 2, z=1), 0.2, 0.0, "stands on z = 1 mm"),
        (box(2, 2, 2, z=-1), 0.2, 0.0, "stands on z = -1 mm"),
        (without_a_face(), 0.2, 0.0, "not watertight, for 3 open edges"),
        (turned_inwards(), 0.2, 0.0, "encloses -8 mm³; turn its faces outwards"),
        (trimesh.Trimesh(), 0.2, 0.0, "has no faces"),
        (box(2, 2, 2) + box(2, 2, 2, x=5), 0.2, 0.0, "its layers make 2 separate bodies"),
        (sheared(), 1.0, 0.0, "its layers make 4 separate bodies; give one body, or thinner layers"),
    ],
)
def test_what_cannot_be_printed_is_refused(
    mesh: trimesh.Trimesh, layer: float, bead: float, sentence: str
) -> None:
    with pytest.raises(ConfigError, match=re.escape(sentence)):
        slice_as_printed(mesh, layer, bead)


def test_a_leaning_part_is_printed_in_layers_that_overlap() -> None:
    assert_one_solid(slice_as_printed(sheared(), 0.2))
