"""Clouds as other programs write them: read with the right places and grey levels, or refused by the line."""

import logging
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fpplab.clouds import load_cloud, load_mesh, save_cloud
from fpplab.clouds.exchange import export_cloud
from fpplab.clouds.files import TEXT_SUFFIXES
from fpplab.core.errors import DataError

XYZ = "property float x\nproperty float y\nproperty float z\n"
ROWS = "1 2 3\n4 5 6\n"
POINTS = [[1, 2, 3], [4, 5, 6]]


def text_ply(properties: str = XYZ, rows: str = ROWS, before: str = "", after: str = "") -> str:
    return f"ply\nformat ascii 1.0\n{before}element vertex 2\n{properties}{after}end_header\n{rows}"


def binary_ply(path: Path, columns: dict[str, tuple[str, list[float]]], tail: bytes = b"") -> Path:
    """Written by the description of the format: columns of (type, values) by name."""
    types = {"float": "f4", "double": "f8", "uchar": "u1", "ushort": "u2", "int": "i4"}
    table = np.empty(2, [(name, "<" + types[kind]) for name, (kind, _) in columns.items()])
    for name, (_, values) in columns.items():
        table[name] = values
    properties = "".join(f"property {kind} {name}\n" for name, (kind, _) in columns.items())
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex 2\n{properties}end_header\n"
    path.write_bytes(header.encode() + table.tobytes() + tail)
    return path


def points(kind: str = "float", offset: float = 0.0) -> dict[str, tuple[str, list[float]]]:
    return {name: (kind, [POINTS[0][i] + offset, POINTS[1][i] + offset]) for i, name in enumerate("xyz")}


READ = {
    "empty lines": text_ply(rows="1 2 3\n\n4 5 6\n\n"),
    "byte order mark": "\ufeff" + text_ply(),
    "carriage returns": text_ply().replace("\n", "\r\n"),
    "comments": text_ply(before="comment a\nobj_info b c\n"),
    "a name of two words": text_ply("property float Scalar field\n" + XYZ, "9 1 2 3\n9 4 5 6\n"),
    "an element before": text_ply(rows="7\n" + ROWS, before="element camera 1\nproperty float view\n"),
    "a list before": text_ply(rows="2 7 7\n" + ROWS, before="element strip 1\nproperty list uchar int at\n"),
    "faces": text_ply(
        rows=ROWS + "3 0 1 1\n", after="element face 1\nproperty list uchar int vertex_indices\n"
    ),
}


@pytest.mark.parametrize("text", READ.values(), ids=READ)
def test_dialects_of_text(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(text.encode())
    assert load_cloud(tmp_path / "a.ply").points.tolist() == POINTS


REFUSED = {
    "an unknown line": (text_ply(before="texture file.png\n"), "line 3 of its header, 'texture file.png'"),
    "an unknown type": (
        text_ply("property half w\n" + XYZ),
        "line 4 .*'property half w', has an unknown type",
    ),
    "a name twice": (text_ply(XYZ + "property float x\n"), "line 7 .* gives a name a second time"),
    "vertices twice": (text_ply(XYZ + "element vertex 2\n"), "line 7 .* announces 'vertex' a second time"),
    "another version": (text_ply().replace("1.0", "2.0", 1), "line 2 .*'format ascii 2.0'"),
    "a number that is none": (text_ply().replace("vertex 2", "vertex -2"), "line 3 .*'element vertex -2'"),
    "no name": (text_ply("property float\n" + XYZ), "line 4 .*'property float'"),
    "a short row": (text_ply(rows="1.0 2\n4 5 6\n"), "line 8 has 2 values instead of 3"),
    "a long row": (text_ply(rows="1 2 3\n4 5 6 7\n"), "line 9 has 4 values instead of 3"),
    "a row too many": (text_ply(rows=ROWS + "7 8 9\n"), "has 3 lines of data, but its header announces 2"),
    "decimal commas": (
        text_ply(rows="1,5 2 3\n4 5 6\n"),
        "line 8: '1,5' is not a number; write decimals with",
    ),
    "a fraction": (
        text_ply(XYZ + "property uchar red\n", "1 2 3 0.5\n4 5 6 300\n"),
        "line 9: red is 0.5, which must be a whole number 0 … 255",
    ),
    "a list": (text_ply(XYZ + "property list uchar float d\n"), "a vertex has the list 'd' as property"),
    "other names": (text_ply(XYZ.replace(" x", " east")), "has no x, y, z, but east, y, z"),
    "carriage returns alone": (text_ply().replace("\n", "\r"), "end in carriage returns alone"),
    "nothing measured": (text_ply(rows="0 0 0\nnan 1 1\n"), "all of its 2 points are 0 0 0 or not finite"),
}


@pytest.mark.parametrize(("text", "reason"), REFUSED.values(), ids=REFUSED)
def test_text_that_is_not_understood(text: str, reason: str, tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(text.encode())
    with pytest.raises(DataError, match=rf"a\.ply: is no readable PLY cloud \(.*{reason}"):
        load_cloud(tmp_path / "a.ply")


def test_bytes_behind_the_last_vertex(tmp_path: Path) -> None:
    assert load_cloud(binary_ply(tmp_path / "a.ply", points())).points.tolist() == POINTS
    with pytest.raises(DataError, match="24 bytes follow its last vertex"):
        load_cloud(binary_ply(tmp_path / "a.ply", points(), bytes(24)))


RGB = ("red", "green", "blue")


@pytest.mark.parametrize(
    ("names", "kind", "value", "grey"),
    [
        (RGB, "uchar", 204, 204),
        (RGB, "ushort", 52428, 204),
        (RGB, "float", 0.8, 204),
        (("r", "g", "b"), "uchar", 204, 204),
        (("diffuse_red", "diffuse_green", "diffuse_blue"), "uchar", 204, 204),
        (("intensity",), "double", 0.8, 204),
        (("gray",), "uchar", 204, 204),
        (RGB, "float", 204.0, None),
        (RGB, "int", 204, None),
        (("intensity",), "float", -0.1, None),
    ],
)
def test_grey_levels_by_their_type(
    names: tuple[str, ...],
    kind: str,
    value: float,
    grey: int | None,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    cloud = load_cloud(
        binary_ply(tmp_path / "a.ply", points() | {name: (kind, [0, value]) for name in names})
    )
    assert (None if cloud.colour is None else cloud.colour.tolist()) == (None if grey is None else [0, grey])
    assert (grey is None) == ("grey levels of " + ", ".join(names) in caplog.text)


@pytest.mark.parametrize("suffix", [".ply", ".xyz", ".npz"])
def test_digits_far_from_the_origin(suffix: str, tmp_path: Path) -> None:
    offset = 5_612_345.625
    cloud = load_cloud(binary_ply(tmp_path / "far.ply", points("double", offset)))
    assert cloud.points.dtype == np.float32
    save_cloud(cloud, tmp_path / f"again{suffix}")
    again = load_cloud(tmp_path / f"again{suffix}")
    for each in (cloud, again, again.only(np.ones(2, np.bool_))):
        assert each.coordinates.tolist() == [[x + offset for x in point] for point in POINTS]
    export_cloud(again, tmp_path / "again.csv")
    assert f"{1 + offset:.9g}" in (tmp_path / "again.csv").read_text(encoding="utf-8")


def test_lost_digits_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    load_cloud(binary_ply(tmp_path / "far.ply", points("float", 5e6)))
    assert "steps of 0.5 mm" in caplog.text


def test_lost_digits_of_a_mesh_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    box = trimesh.creation.box((30.0, 20.0, 10.0))
    box.export(tmp_path / "near.stl")
    load_mesh(tmp_path / "near.stl")
    assert not caplog.text
    box.apply_translation([5e6, 0.0, 0.0])
    box.export(tmp_path / "far.stl")
    load_mesh(tmp_path / "far.stl")
    assert "far.stl: its coordinates have steps of 0.5 mm" in caplog.text


@pytest.mark.parametrize("placeholder", [(-9999.0, -9999.0, -9999.0), (-1.0, -1.0, -1.0), (0.0, 0.0, 1e10)])
@pytest.mark.parametrize("count", [300, 30_000])
def test_placeholders_are_left_out(
    placeholder: tuple[float, float, float], count: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    measured = np.random.default_rng(1).normal((0.0, 0.0, 450.0), 20.0, (count, 3)).round(3)
    rows = np.insert(measured, np.arange(0, count, 7), placeholder, axis=0)
    np.savetxt(tmp_path / "a.xyz", rows, fmt="%.3f")
    cloud = load_cloud(tmp_path / "a.xyz")
    assert np.allclose(cloud.coordinates, measured, atol=1e-4)
    assert f"{len(rows) - count} points of {len(rows)} are {placeholder[0]:g} " in caplog.text


def test_names_of_coordinates_may_be_capitals(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_text(
        text_ply(XYZ.replace(" x", " X").replace(" y", " Y").replace(" z", " Z"), "1 2 450\n3 4 451\n")
    )
    assert load_cloud(path).points.tolist() == [[1, 2, 450], [3, 4, 451]]


@pytest.mark.parametrize("coding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_a_ply_file_in_another_coding_is_refused(coding: str, tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_text(text_ply(XYZ, "1 2 450\n3 4 451\n"), encoding=coding)
    with pytest.raises(DataError, match="it is in UTF-16; save it in UTF-8"):
        load_cloud(path)


@pytest.mark.parametrize(("z", "suffix"), [(0.0, ".xyz"), (-1.0, ".ply"), (-32768.0, ".xyz")])
@pytest.mark.parametrize("count", [300, 30_000])
def test_points_without_a_depth_are_left_out(
    z: float, suffix: str, count: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rows = np.random.default_rng(1).normal((0.0, 0.0, 450.0), 20.0, (count, 3)).round(3)
    measured = rows[np.arange(count) % 5 != 0]
    rows[::5, 2] = z
    path = tmp_path / f"a{suffix}"
    if suffix == ".ply":
        text = text_ply(XYZ, "".join(f"{x} {y} {z}\n" for x, y, z in rows.tolist()))
        path.write_text(text.replace("vertex 2", f"vertex {count}"), encoding="ascii")
    else:
        np.savetxt(path, rows, fmt="%.3f")
    assert np.allclose(load_cloud(path).coordinates, measured, atol=1e-4)
    assert (
        f"{count // 5} points of {count} are at z = {z:g}, 0 0 0 or not finite; they are left out"
        in caplog.text
    )


@pytest.mark.parametrize("height", [0.0, 5.0])
def test_flat_surfaces_are_kept(height: float, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A part on a plate of exactly z = 0, and a step of exactly one height: of a file that a program made."""
    rows = np.random.default_rng(1).uniform((-20.0, -20.0, 0.0), (20.0, 20.0, 20.0), (4000, 3)).round(3)
    rows[:3600, 2] = 0.0
    if height:
        rows[3600:, 2] = height
    np.savetxt(tmp_path / "a.xyz", rows, fmt="%.3f")
    assert len(load_cloud(tmp_path / "a.xyz").points) == 4000
    assert "3600 points of 4000 are at exactly z = 0: measured, or missing?" in caplog.text


@pytest.mark.parametrize("repeats", [2, 40])
def test_points_that_all_repeat_are_kept(
    repeats: int, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Points that were joined twice, or rounded to whole mm."""
    rows = np.repeat(np.random.default_rng(2).normal(0.0, 20.0, (200, 3)), repeats, axis=0)
    np.savetxt(tmp_path / "a.xyz", rows, fmt="%.3f")
    assert len(load_cloud(tmp_path / "a.xyz").points) == len(rows)
    assert not caplog.text


@pytest.mark.parametrize("missing", [0.0, np.nan, np.inf])
@pytest.mark.parametrize("suffix", [".ply", ".xyz", ".npz"])
def test_points_that_were_not_measured(
    missing: float, suffix: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    xyz = np.array([*POINTS, [missing] * 3], np.float32)
    pixels = np.array([[0, 0], [1, 0], [1, 1]], np.int32)
    path = tmp_path / f"a{suffix}"
    if suffix == ".ply":
        rows = "".join(f"{x} {y} {z} {u} {v}\n" for (x, y, z), (u, v) in zip(xyz, pixels, strict=True))
        properties = XYZ + "property int pixel_u\nproperty int pixel_v\n"
        text = text_ply(properties, rows, before="comment camera_size 2 2\n")
        path.write_text(text.replace("vertex 2", "vertex 3"), encoding="ascii")
    elif suffix == ".xyz":
        np.savetxt(path, xyz)
    else:
        np.savez(path, points=xyz, pixels=pixels, size=(2, 2))
    cloud = load_cloud(path)
    assert cloud.points.tolist() == POINTS
    if suffix != ".xyz":
        assert cloud.pixels is not None
        assert cloud.pixels.tolist() == [[0, 0], [1, 0]]
    assert "1 points of 3 are 0 0 0 or not finite; they are left out" in caplog.text


@pytest.mark.parametrize(
    "text",
    [
        "1\t2\t3\n4\t5\t6\n",
        "1,2,3\n4,5,6\n",
        "1, 2, 3\n4, 5, 6\n",
        "1;2;3\r\n4;5;6\r\n",
        "\ufeff1 2 3\n\n4 5 6\n",
        "2\n1 2 3\n4 5 6\n",
        "# a comment\nX Y Z\n1 2 3\n4 5 6\n",
        "// x [mm];y [mm];z [mm]\n1;2;3\n4;5;6\n",
        '"label","z_mm","y_mm","x_mm"\na,3,2,1\nb,6,5,4\n',
        "1 2 3 0.5\n4 5 6 0.5\n",
        "1,0;2,0;3,0\r\n4,0;5,0;6,0\r\n",
        "1,0;2;3\n4;5;6,0\n",
        "1,0 2,00 3,0e0\n4,0 5,00 6,0e0\n",
        "x_mm;y_mm;z_mm\n1,000;2,0;3,000\n4,000;5,0;6,000\n",
    ],
)
def test_dialects_of_xyz(text: str, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    for suffix in TEXT_SUFFIXES:
        encoding = "utf-16" if suffix == ".csv" and not text.startswith("\ufeff") else "utf-8"
        (tmp_path / f"a{suffix}").write_bytes(text.encode(encoding))
        assert load_cloud(tmp_path / f"a{suffix}").points.tolist() == POINTS
    assert ("4 columns; only x, y, z are read" in caplog.text) == ("label" in text or "0.5" in text)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("1,500 2,500 3,500\n", "'1,500' may have a decimal comma or count thousands"),
        ("1,5;2.5;3,5\n", "line 1: '1,5' is not a number; write decimals with points"),
        ("1 2 3\n4 5\n", "line 1 has 3 values instead of 2|line 2 has 2 values"),
        ("1 2 3\n4 5 6 7\n", "line 1 has 3 values instead of 4"),
        ("x_m y_m z_m\n1 2 3\n", "its first line, 'x_m y_m z_m', names no x, y, z in mm"),
        ("1 2 3\n4 five 6\n", "line 2: 'five' is not a number"),
    ],
)
def test_xyz_that_is_not_understood(text: str, reason: str, tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=rf"a\.xyz: is no readable XYZ cloud \(({reason})"):
        load_cloud(tmp_path / "a.xyz")


def test_a_cloud_under_another_suffix_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("ply\nformat ascii 1.0\nelement vertex 0\nend_header\n")
    with pytest.raises(DataError, match=r"a\.txt: is a PLY file of points, whose name must end in \.ply"):
        load_cloud(tmp_path / "a.txt")


def test_lengths_in_metres_are_told_at_every_door(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING)
    (tmp_path / "a.xyz").write_text("0 0 0.4\n0.03 0.02 0.41\n")
    load_cloud(tmp_path / "a.xyz")
    assert "is 0.0374 mm across; lengths must be in mm" in caplog.text
    caplog.clear()
    (tmp_path / "a.xyz").write_text("0 0 400\n30 20 410\n")
    load_cloud(tmp_path / "a.xyz")
    assert not caplog.text
