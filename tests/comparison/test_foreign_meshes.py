"""Meshes and clouds of other programs in a comparison: damaged, wound this way and that, in another unit."""

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from fpplab import compare, decode, reconstruct
from fpplab.clouds import Cloud, load_mesh, save_cloud
from fpplab.comparison.units import check_units
from fpplab.core.errors import ConfigError, DataError

pytestmark = pytest.mark.usefixtures("foreign_files_read_here")

CORNERS = np.array(
    [[0, 0, 0], [30, 0, 0], [30, 20, 0], [0, 20, 0], [5, 4, 6], [22, 3, 6], [24, 14, 5], [6, 15, 7]], float
)


def part() -> trimesh.Trimesh:
    """A closed part without symmetry, in front of the camera at the origin."""
    mesh: trimesh.Trimesh = trimesh.convex.convex_hull(CORNERS - [15, 10, 0])
    mesh.apply_transform(np.diag([1.0, -1.0, -1.0, 1.0]))
    mesh.apply_translation([3.0, -2.0, 450.0])
    return mesh


def points(mesh: trimesh.Trimesh) -> NDArray[np.float64]:
    """What a camera at the origin sees of the part, with noise of 5 µm along the normals."""
    sampled, faces = trimesh.sample.sample_surface(mesh, 4000, seed=1)
    normals = mesh.face_normals[faces]
    noise = np.random.default_rng(1).normal(0.0, 0.005, len(sampled))
    return np.asarray((sampled + normals * noise[:, None])[normals[:, 2] < -0.17])


def binary_stl(header: bytes = b"") -> bytes:
    """The part as STL, by the description of the format."""
    mesh = part()
    faces = b"".join(struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 0) for triangle in mesh.triangles)
    return header.ljust(80, b"\0") + struct.pack("<I", len(mesh.faces)) + faces


def text_stl() -> bytes:
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x!r} {y!r} {z!r}\n" for x, y, z in triangle.tolist())
        + "endloop\nendfacet\n"
        for triangle in part().triangles
    )
    return f"solid facet\n{facets}endsolid facet\n".encode()


@pytest.mark.parametrize(
    "content", [binary_stl(), binary_stl(b"solid facet"), text_stl()], ids=["binary", "solid", "text"]
)
def test_stl_files(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "part.stl").write_bytes(content)
    assert load_mesh(tmp_path / "part.stl").volume == pytest.approx(part().volume, rel=1e-4)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (binary_stl()[:-25], r"it holds 11 of 12 faces"),
        (binary_stl()[:80] + struct.pack("<I", 55866) + binary_stl()[84:], r"it holds 12 of 55866 faces"),
        (binary_stl() + bytes(20), r"20 bytes follow the 12 faces"),
        (binary_stl()[:50], r"it ends after 50 bytes, within its header"),
        (text_stl()[:-200], r"it is cut off: 1[01] of 1[12] faces are complete"),
    ],
)
def test_damaged_stl_files(content: bytes, reason: str, tmp_path: Path) -> None:
    (tmp_path / "part.stl").write_bytes(content)
    with pytest.raises(DataError, match=rf"part\.stl: is no readable STL mesh \(.*{reason}"):
        load_mesh(tmp_path / "part.stl")


def turned(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    faces = mesh.faces.copy()
    faces[::2] = faces[::2, ::-1]
    return trimesh.Trimesh(mesh.vertices, faces, process=False)


def test_faces_wound_this_way_and_that(tmp_path: Path) -> None:
    turned(part()).export(tmp_path / "part.stl")
    mesh = load_mesh(tmp_path / "part.stl")
    assert mesh.is_winding_consistent
    assert mesh.volume == pytest.approx(part().volume, rel=1e-4)
    beside = part().vertices + [50.0, 0.0, 0.0]
    two = turned(trimesh.Trimesh([*part().vertices, *beside], [*part().faces, *(part().faces + len(beside))]))
    with pytest.raises(DataError, match="not wound consistently"):
        compare(Cloud(points(part()).astype(np.float32)), two)


TRIANGLE_PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
0 0 0
9 0 0

0 9 0
3 0 1 2
3 2 1 0
"""
TRIANGLE_OBJ = "v 0 0 0\nv 9 0 0\nv 0 9 0\nf 1 2 3\nf -1 -2 \\\n-3\n"


@pytest.mark.parametrize(
    ("suffix", "text", "reason"),
    [
        ("ply", TRIANGLE_PLY, None),
        ("ply", TRIANGLE_PLY.removesuffix("3 2 1 0\n"), "it has 4 lines of data, but its header announces 5"),
        ("ply", TRIANGLE_PLY + "3 0 2 1\n", "it has 6 lines of data, but its header announces 5"),
        ("obj", TRIANGLE_OBJ, None),
        ("obj", TRIANGLE_OBJ.replace("f 1 2 3", "f 1 2"), "line 4 has a face of 2 corners; is it cut off"),
        ("obj", TRIANGLE_OBJ.replace("v 9 0 0", "v 9 0"), "line 2 has 2 coordinates instead of 3"),
        ("obj", TRIANGLE_OBJ.replace("f 1 2 3", "f 0 1 2"), "line 4 names corner 0"),
    ],
)
def test_meshes_as_text(suffix: str, text: str, reason: str | None, tmp_path: Path) -> None:
    path = tmp_path / f"part.{suffix}"
    path.write_text(text, encoding="ascii")
    if reason is None:
        assert len(load_mesh(path).faces) == 2
        return
    with pytest.raises(
        DataError, match=rf"part\.{suffix}: is no readable {suffix.upper()} mesh \(.*{reason}"
    ):
        load_mesh(path)


@pytest.mark.parametrize(
    ("mesh_scale", "cloud_scale", "reason"),
    [
        (1 / 25.4, 1.0, "the mesh is 25.4 times too small, as between inches and mm"),
        (0.1, 1.0, "the mesh is 10 times too small, as between cm and mm"),
        (0.001, 1.0, "the mesh is 1000 times too small, as between m and mm"),
        (1.0, 0.001, "the cloud is 1000 times too small, as between m and mm"),
        (1000.0, 1.0, "the mesh is 1000 times too large, as between µm and mm, and fits .* divided"),
        (1.0, 1000.0, "the cloud is 1000 times too large, as between µm and mm, and fits .* divided"),
        (0.001, 0.001, "both must be in mm: of m, multiply all coordinates by 1000"),
    ],
)
def test_other_units(mesh_scale: float, cloud_scale: float, reason: str) -> None:
    cloud = Cloud((cloud_scale * points(part())).astype(np.float32))
    with pytest.raises(DataError, match=reason):
        compare(cloud, trimesh.Trimesh(mesh_scale * part().vertices, part().faces))


@pytest.mark.whole
def test_a_large_shape_of_which_little_is_seen() -> None:
    large = trimesh.creation.box([300.0, 200.0, 10.0])
    large.apply_translation([0.0, 0.0, 455.0])
    seen = np.random.default_rng(0).uniform([-15, -10, 450], [15, 10, 450], (2000, 3))
    check_units(seen, large)  # raises nothing


def test_digits_far_from_the_origin(tmp_path: Path) -> None:
    offset = np.array([501_234.5, 5.6123456e6, 120.0])
    near = Cloud(points(part()).astype(np.float32))
    far = Cloud((near.points - [0, 0, 450]).astype(np.float32), origin_mm=tuple(offset + [0, 0, 450]))
    assert compare(far, part().apply_translation(offset)).surface_rms_um == pytest.approx(
        compare(near, part()).surface_rms_um, abs=0.05
    )


def test_paths_are_taken_for_objects(tmp_path: Path) -> None:
    save_cloud(Cloud(points(part()).astype(np.float32)), tmp_path / "part.ply")
    (tmp_path / "part.stl").write_bytes(binary_stl())
    result = compare(str(tmp_path / "part.ply"), tmp_path / "part.stl")
    assert result.surface_rms_um == pytest.approx(5.0, abs=0.3)
    with pytest.raises(ConfigError, match="cloud: takes a Cloud or the path of its file, not a list"):
        compare([[1, 2, 3]], tmp_path / "part.stl")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="mesh: takes a Trimesh or the path of its file, not a Cloud"):
        compare(tmp_path / "part.ply", Cloud(points(part()).astype(np.float32)))  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"takes a Recording, such as session.recording\(\), not a str"):
        decode("session")  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="session: takes a Session or the path of its file, not a int"):
        reconstruct(3, 4)  # type: ignore[arg-type]
    with pytest.raises(DataError, match="nowhere"):
        reconstruct(tmp_path / "nowhere", tmp_path / "nowhere.yaml")
