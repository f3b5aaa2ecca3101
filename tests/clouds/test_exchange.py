"""Clouds in the files of other programs, read back by the libraries that read them."""

import csv
import zipfile
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pye57
import pytest
import trimesh

from fpplab.clouds import Cloud, load_cloud
from fpplab.clouds.exchange import EXPORTED, MAX_E57_PIXEL, export_cloud
from fpplab.core.errors import ConfigError, DataError
from fpplab.core.extras import MissingExtraError

NM_PER_MM = 1e6


def cloud(size: tuple[int, int] = (12, 9), pitch_mm: float = 0.37) -> Cloud:
    """A wavy surface over the pixels, with a hole, and all attributes."""
    width, height = size
    v, u = (each.ravel() for each in np.mgrid[:height, :width])
    known = (u != 3) | (v != 4)
    u, v = u[known], v[known]
    random = np.random.default_rng(5)
    points = np.stack([u * pitch_mm - 1.5, v * pitch_mm - 1.2, 400 + 0.05 * np.sin(u)], axis=1)
    sigma = random.uniform(0.001, 0.01, len(u)).astype(np.float32)
    return Cloud(
        points.astype(np.float32),
        np.stack([u, v], axis=1).astype(np.int32),
        size,
        np.tile(np.array([0, 0, -1], np.float32), (len(u), 1)),
        random.integers(0, 256, len(u)).astype(np.uint8),
        sigma,
        2 * sigma,
        sigma / 2,
        sigma * 7,
    )


BARE = Cloud(cloud().points)


@pytest.mark.parametrize("column", [MAX_E57_PIXEL, MAX_E57_PIXEL + 1])
def test_e57_has_pixels_that_its_16_bits_hold(column: int, tmp_path: Path) -> None:
    pixels = np.array([[0, 0], [column, 1]], np.int32)
    export_cloud(Cloud(cloud().points[:2], pixels, (column + 1, 2)), tmp_path / "wide.e57")
    with pye57.E57(str(tmp_path / "wide.e57")) as file:
        data = file.read_scan_raw(0)
    found = data["columnIndex"].tolist() if "columnIndex" in data else None
    assert found == ([0, column] if column < 2**16 else None)


def test_e57_is_exact_in_metres(tmp_path: Path) -> None:
    path = tmp_path / "part.e57"
    export_cloud(cloud(), path)
    with pye57.E57(str(path)) as file:
        name = file.get_header(0)["name"].value()
        data = file.read_scan_raw(0)
    xyz = np.stack([data[f"cartesian{axis}"] for axis in "XYZ"], axis=1)
    assert 0.39 < xyz[:, 2].min() < xyz[:, 2].max() < 0.41
    np.testing.assert_array_equal((1e3 * xyz).astype(np.float32), cloud().points)
    np.testing.assert_array_equal(np.stack([data["columnIndex"], data["rowIndex"]], axis=1), cloud().pixels)
    np.testing.assert_array_equal(data["intensity"], cloud().colour)
    np.testing.assert_array_equal(data["colorGreen"], cloud().colour)
    assert name == "part"


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las_within_half_a_nanometre(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"part{suffix}"
    export_cloud(cloud(), path)
    found = laspy.read(path)
    assert found.header.are_points_compressed == (suffix == ".laz")
    errors_mm = 1e3 * found.xyz - cloud().points
    assert np.abs(errors_mm).max() * NM_PER_MM <= 0.5001
    np.testing.assert_array_equal(found.intensity, 257 * cloud().colour.astype(np.uint16))
    np.testing.assert_array_equal(found.red, found.intensity)
    assert found.header.global_encoding.wkt  # demanded by LAS 1.4 (R15) of point formats 6 to 10
    assert set(found.return_number) == set(found.number_of_returns) == {1}
    for name, values in (
        ("pixel_v", cloud().pixels[:, 1]),
        ("nz", cloud().normals[:, 2]),
        ("sigma_noise_mm", cloud().sigma_noise_mm),
        ("sigma_mm", cloud().sigma_mm),
        ("epipolar_px", cloud().epipolar_px),
    ):
        np.testing.assert_array_equal(found[name], values)


def test_las_of_a_large_part_has_larger_steps(tmp_path: Path) -> None:
    large = cloud(pitch_mm=1000.0)
    export_cloud(large, tmp_path / "large.las")
    found = laspy.read(tmp_path / "large.las")
    assert found.header.scales.tolist() == [1e-8] * 3
    assert np.abs(1e3 * found.xyz - large.points).max() * NM_PER_MM <= 5.001


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".3mf"])
def test_surfaces(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"part{suffix}"
    export_cloud(cloud(), path)
    found = trimesh.load(path, force="mesh", process=False)
    vertices, faces = cloud().grid_mesh()
    expected = vertices[faces]
    assert len(faces) == 2 * 11 * 8 - 4  # of the squares around the hole, each gives one triangle of two
    np.testing.assert_allclose(found.vertices[found.faces], expected, rtol=0, atol=1e-8)
    if suffix == ".3mf":
        with zipfile.ZipFile(path) as archive:
            assert b'unit="millimeter"' in archive.read("3D/3dmodel.model")


def test_csv_has_all_digits_of_all_columns(tmp_path: Path) -> None:
    path = tmp_path / "part.csv"
    export_cloud(cloud(), path)
    with path.open(encoding="utf-8", newline="") as stream:
        rows = [*csv.DictReader(stream)]
    assert len(rows) == len(cloud())
    columns = {name: np.array([float(row[name]) for row in rows], np.float32) for name in rows[0]}
    np.testing.assert_array_equal(columns["x_mm"], cloud().points[:, 0])
    np.testing.assert_array_equal(columns["sigma_mm"], cloud().sigma_mm)
    np.testing.assert_array_equal(columns["sigma_form_mm"], cloud().sigma_form_mm)
    np.testing.assert_array_equal(columns["grey"], cloud().colour)
    assert rows[1]["pixel_u"] == "1"


@pytest.mark.parametrize("suffix", [".ply", ".npz"])
def test_own_formats(suffix: str, tmp_path: Path) -> None:
    export_cloud(cloud(), tmp_path / f"part{suffix}")
    np.testing.assert_array_equal(load_cloud(tmp_path / f"part{suffix}").sigma_mm, cloud().sigma_mm)


@pytest.mark.parametrize("suffix", [".e57", ".las", ".laz", ".csv", ".xyz"])
def test_points_alone(suffix: str, tmp_path: Path) -> None:
    export_cloud(BARE, tmp_path / f"part{suffix}")
    assert (tmp_path / f"part{suffix}").stat().st_size > 0


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".3mf"])
def test_a_surface_needs_pixels(suffix: str, tmp_path: Path) -> None:
    with pytest.raises(DataError, match="not known by camera pixel"):
        export_cloud(BARE, tmp_path / f"part{suffix}")
    one = Cloud(BARE.points[:1], np.zeros((1, 2), np.int32), (2, 2))
    with pytest.raises(DataError, match="no three neighbouring pixels"):
        export_cloud(one, tmp_path / f"part{suffix}")
    assert not [*tmp_path.iterdir()]


def test_another_suffix(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"part.txt: its name must end in .ply, .xyz, .npz, .e57, .*\.csv"):
        export_cloud(BARE, tmp_path / "part.txt")


@pytest.mark.parametrize("suffix", [".e57", ".las", ".laz", ".3mf"])
def test_a_missing_library_is_named(suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fpplab.core.extras.find_spec", lambda module: None)
    with pytest.raises(MissingExtraError, match=r"pip install 'fpplab\[files\]'"):
        export_cloud(BARE, tmp_path / f"part{suffix}")


@pytest.mark.parametrize("suffix", EXPORTED)
def test_where_nothing_can_be_written(suffix: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(DataError, match="cannot be written"):
        export_cloud(cloud(), tmp_path / "file" / f"part{suffix}")


def test_colours_of_points_go_everywhere(tmp_path: Path) -> None:
    rgb = np.random.default_rng(6).integers(0, 256, (len(cloud()), 3)).astype(np.uint8)
    coloured = replace(cloud(), rgb=rgb)
    for suffix in (".ply", ".npz", ".e57", ".las", ".csv"):
        export_cloud(coloured, tmp_path / f"part{suffix}")
    for suffix in (".ply", ".npz"):
        np.testing.assert_array_equal(load_cloud(tmp_path / f"part{suffix}").rgb, rgb)
    with pye57.E57(str(tmp_path / "part.e57")) as file:
        data = file.read_scan_raw(0)
    np.testing.assert_array_equal(data["colorBlue"], rgb[:, 2])
    np.testing.assert_array_equal(data["intensity"], cloud().colour)
    las = laspy.read(tmp_path / "part.las")
    np.testing.assert_array_equal(las.green, 257 * rgb[:, 1].astype(np.uint16))
    with (tmp_path / "part.csv").open() as table:
        assert [int(row["red"]) for row in csv.DictReader(table)] == rgb[:, 0].tolist()
    assert coloured.only(np.arange(len(rgb)) < 5).rgb is not None
    grey = tmp_path / "grey.ply"
    export_cloud(cloud(), grey)
    assert load_cloud(grey).rgb is None
