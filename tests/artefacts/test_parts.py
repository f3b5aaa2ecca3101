"""Parts from files: read as one solid, or refused in a sentence that names the file and the remedy."""

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fpplab.artefacts import load_part
from fpplab.core.errors import ConfigError

pytestmark = pytest.mark.usefixtures("foreign_files_read_here")

BOX = trimesh.creation.box((20.0, 30.0, 40.0))


def with_corner(value: float, suffix: str) -> bytes:
    """The box as a file whose first coordinate has that value instead of its own."""
    if suffix == "stl":  # after head, count and the first normal
        data = BOX.export(file_type=suffix)
        return data[:96] + struct.pack("<f", value) + data[100:]
    corners = BOX.vertices.copy()
    corners[0, 0] = value
    data = trimesh.Trimesh(corners, BOX.faces, process=False).export(file_type=suffix)
    return data if isinstance(data, bytes) else data.encode()


def with_seams() -> str:
    """An OBJ in which every corner of every face has a texture coordinate of its own."""
    lines = [f"v {x} {y} {z}" for x, y, z in BOX.vertices]
    lines += [f"vt {i / 36} 0" for i in range(36)]
    lines += [
        "f " + " ".join(f"{corner + 1}/{3 * i + j + 1}" for j, corner in enumerate(face))
        for i, face in enumerate(BOX.faces)
    ]
    return "\n".join(lines)


def in_two_groups() -> str:
    """An OBJ whose faces belong to two objects that share their corners."""
    lines = [f"v {x} {y} {z}" for x, y, z in BOX.vertices]
    faces = ["f " + " ".join(str(corner + 1) for corner in face) for face in BOX.faces]
    return "\n".join([*lines, "o one", *faces[:6], "o two", *faces[6:]])


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("suffix", ["stl", "ply", "obj", "STL"])
def test_a_part_is_read_as_one_solid(tmp_path: Path, suffix: str) -> None:
    BOX.export(tmp_path / f"part.{suffix}", file_type=suffix.lower())
    part = load_part(tmp_path / f"part.{suffix}")
    assert part.is_watertight
    assert len(part.vertices) == 8
    assert part.volume == pytest.approx(24000.0)
    assert part.bounds == pytest.approx(BOX.bounds)


@pytest.mark.whole
@pytest.mark.parametrize("text", [with_seams(), in_two_groups()], ids=["seams", "groups"])
def test_seams_of_texture_and_groups_do_not_open_a_part(tmp_path: Path, text: str) -> None:
    (tmp_path / "part.obj").write_text(text)
    assert load_part(tmp_path / "part.obj").volume == pytest.approx(24000.0)


def test_files_that_are_no_mesh_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.stl: there is no such file; check the path"):
        load_part(tmp_path / "none.stl")
    with pytest.raises(ConfigError, match=r"there is no such file"):
        load_part(tmp_path)
    (tmp_path / "part.step").write_text("ISO-10303-21;")
    with pytest.raises(ConfigError, match=r"part\.step: is a STEP model"):
        load_part(tmp_path / "part.step")
    (tmp_path / "torn.ply").write_bytes(BOX.export(file_type="ply")[:200])
    with pytest.raises(ConfigError, match=r"torn\.ply: is no readable PLY mesh .*; export it again"):
        load_part(tmp_path / "torn.ply")


@pytest.mark.whole_after(1)
@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("solid.stl", b"solid nothing\nendsolid nothing\n", "holds no faces; give a mesh"),
        ("page.stl", b"<html>\n" * 50, "is a page in HTML; expected a mesh"),
        ("torn.stl", BOX.export(file_type="stl")[:300], "is no readable STL mesh .*it holds 4 of 12 faces"),
        ("cloud.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "is an OBJ file without faces; expected a mesh"),
    ],
)
def test_files_without_faces_are_refused(tmp_path: Path, name: str, content: bytes, sentence: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ConfigError, match=f"{name}: {sentence}"):
        load_part(tmp_path / name)


@pytest.mark.whole
def test_empty_files_are_called_empty(tmp_path: Path) -> None:
    (tmp_path / "empty.stl").write_bytes(b"")
    with pytest.raises(ConfigError, match=r"empty\.stl: is empty; expected a mesh"):
        load_part(tmp_path / "empty.stl")


@pytest.mark.whole
@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_corners_that_are_not_finite_are_refused(tmp_path: Path, suffix: str, value: float) -> None:
    (tmp_path / f"part.{suffix}").write_bytes(with_corner(value, suffix))
    with pytest.raises(ConfigError, match=rf"part\.{suffix}: has corners that are not finite"):
        load_part(tmp_path / f"part.{suffix}")


def refused(tmp_path: Path, mesh: trimesh.Trimesh, sentence: str) -> None:
    mesh.export(tmp_path / "part.stl")
    with pytest.raises(ConfigError, match=rf"part\.stl: {sentence}"):
        load_part(tmp_path / "part.stl")


def test_a_surface_with_a_hole_is_refused_with_its_open_edges(tmp_path: Path) -> None:
    refused(
        tmp_path,
        trimesh.Trimesh(BOX.vertices, BOX.faces[1:]),
        "is not watertight, for 3 open edges .*; close its surface",
    )


def test_lengths_in_metres_are_refused(tmp_path: Path) -> None:
    metres = BOX.copy().apply_scale(0.001)
    refused(tmp_path, metres, "looks like metres, for it is 0.04 mm large; scale by 1000")


def test_faces_the_wrong_way_round_are_refused(tmp_path: Path) -> None:
    inwards = BOX.copy()
    inwards.invert()
    refused(tmp_path, inwards, "encloses -24000 mm³; turn its faces outwards")


def test_faces_of_both_directions_are_turned_outwards_or_refused(tmp_path: Path) -> None:
    faces = BOX.faces.copy()
    faces[0] = faces[0, ::-1]
    mixed = trimesh.Trimesh(BOX.vertices, faces)
    mixed.export(tmp_path / "part.stl")
    assert load_part(tmp_path / "part.stl").volume == pytest.approx(BOX.volume)
    inside = mixed.copy().apply_scale(0.5)  # of two shells it is not known which is the hollow of the other
    refused(tmp_path, trimesh.util.concatenate([mixed, inside]), "has faces of both directions")
