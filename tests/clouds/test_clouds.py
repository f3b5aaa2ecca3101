"""Clouds survive their files, and files that are not clouds are refused in one sentence."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fpplab.clouds import Cloud, load_cloud, load_mesh, local_quadric_distance, ply, save_cloud
from fpplab.core.errors import ConfigError, DataError

N, SIZE = 50, (40, 30)


def a_cloud(**changes: object) -> Cloud:
    random = np.random.default_rng(0)
    places = random.permutation(SIZE[0] * SIZE[1])[:N]
    normals = random.normal(size=(N, 3))
    parts: dict[str, object] = {
        "points": random.normal([0, 0, 450], 20.0, (N, 3)).astype(np.float32),
        "pixels": np.stack([places % SIZE[0], places // SIZE[0]], axis=1).astype(np.int32),
        "size": SIZE,
        "normals": (normals / np.linalg.norm(normals, axis=1)[:, None]).astype(np.float32),
        "colour": random.integers(0, 256, N).astype(np.uint8),
        "sigma_noise_mm": random.random(N).astype(np.float32),
        "sigma_phase_error_mm": random.random(N).astype(np.float32),
        "sigma_calibration_mm": random.random(N).astype(np.float32),
        "sigma_form_mm": random.random(N).astype(np.float32),
        "epipolar_px": random.random(N).astype(np.float32),
    }
    return Cloud(**(parts | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize("suffix", [".ply", ".npz"])
def test_everything_known_survives_the_file(tmp_path: Path, suffix: str) -> None:
    cloud, path = a_cloud(), tmp_path / f"cloud{suffix}"
    save_cloud(cloud, path)
    read = load_cloud(path)
    for field in fields(Cloud):
        before, after = getattr(cloud, field.name), getattr(read, field.name)
        assert np.array_equal(before, after), field.name
        if field.name not in ("size", "origin_mm", "rgb"):  # grey, as most cameras are
            assert before.dtype == after.dtype


def test_ply_names_the_parts_of_the_uncertainty_and_both_together(tmp_path: Path) -> None:
    cloud, path = a_cloud(), tmp_path / "cloud.ply"
    save_cloud(cloud, path)
    table, comments = ply.read(path)
    parts = cloud.sigma_noise_mm, cloud.sigma_phase_error_mm, cloud.sigma_calibration_mm
    assert np.allclose(table["sigma_mm"] ** 2, np.sum(np.square(parts), axis=0))  # type: ignore[arg-type]
    assert np.array_equal(table["sigma_form_mm"], cloud.sigma_form_mm)  # type: ignore[arg-type]
    assert any("sigma_calibration_mm common to all" in text for text in comments)


def test_what_the_calibration_does_not_tell_is_absent(tmp_path: Path) -> None:
    cloud, path = (
        a_cloud(sigma_calibration_mm=None, sigma_form_mm=None, sigma_phase_error_mm=None),
        tmp_path / "cloud.ply",
    )
    assert cloud.sigma_mm is None
    save_cloud(cloud, path)
    names = ply.read(path)[0].dtype.names or ()
    assert [name for name in names if name.startswith("sigma")] == ["sigma_noise_mm"]
    read = load_cloud(path)
    assert np.array_equal(read.sigma_noise_mm, cloud.sigma_noise_mm)  # type: ignore[arg-type]
    assert (read.sigma_calibration_mm, read.sigma_form_mm, read.sigma_mm) == (None, None, None)


@pytest.mark.parametrize("suffix", [".ply", ".npz", ".xyz"])
def test_points_alone_survive_the_file(tmp_path: Path, suffix: str) -> None:
    points = a_cloud().points
    save_cloud(Cloud(points), tmp_path / f"cloud{suffix}")
    read = load_cloud(tmp_path / f"cloud{suffix}")
    assert np.abs(read.points - points).max() < 1e-5
    assert read.pixels is None
    assert read.normals is None


def test_others_read_our_ply(tmp_path: Path) -> None:
    cloud = a_cloud()
    save_cloud(cloud, tmp_path / "cloud.ply")
    read = trimesh.load(tmp_path / "cloud.ply")
    assert np.allclose(read.vertices, cloud.points)


@pytest.mark.parametrize("kind", ["ascii", "binary_big_endian"])
def test_ply_from_elsewhere_is_read(tmp_path: Path, kind: str) -> None:
    header = (
        f"ply\nformat {kind} 1.0\ncomment elsewhere\nelement vertex 2\nproperty double x\nproperty double y\n"
        "property double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
        "element face 0\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = [(1.0, 2.0, 3.0, 10, 20, 30), (4.0, 5.0, 6.0, 255, 255, 255)]
    dtype = [(name, ">f8") for name in "xyz"] + [(name, "u1") for name in "rgb"]
    ascii_body = "".join(" ".join(map(str, row)) + "\n" for row in rows).encode()
    body = ascii_body if kind == "ascii" else np.array(rows, dtype).tobytes()
    (tmp_path / "other.ply").write_bytes(header.encode() + body)
    read = load_cloud(tmp_path / "other.ply")
    assert read.points.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert read.colour is not None
    assert read.colour.tolist() == [20, 255]


def test_xyz_with_comments_and_further_columns_is_read(tmp_path: Path) -> None:
    (tmp_path / "other.xyz").write_text("# from elsewhere\n1 2 3 0.5\n4 5 6 0.5\n")
    assert load_cloud(tmp_path / "other.xyz").points.tolist() == [[1, 2, 3], [4, 5, 6]]


DAMAGED = {
    "empty.ply": b"",
    "other.ply": b"solid\n",
    "short.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n"
    b"property float x\nproperty float y\nproperty float z\nend_header\nxxxx",
    "flat.ply": b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n",
    "endless.ply": b"ply\nformat ascii 1.0\n",
    "list.ply": b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\nend_header\n",
    "empty.xyz": b"",
    "words.xyz": b"a b c\n",
    "nan.xyz": b"1 2 nan\n",
    "two.xyz": b"1 2\n",
    "no.npz": b"no archive",
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damaged_files_are_refused_by_name(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(DAMAGED[name])
    with pytest.raises(DataError, match=name):
        load_cloud(tmp_path / name)


def test_missing_files_and_unknown_suffixes_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"none\.ply: there is no such file"):
        load_cloud(tmp_path / "none.ply")
    with pytest.raises(DataError, match=r"none\.stl: there is no such file"):
        load_mesh(tmp_path / "none.stl")
    with pytest.raises(ConfigError, match=r"\.ply, \.xyz, \.npz"):
        load_cloud(tmp_path / "cloud.las")
    with pytest.raises(ConfigError, match=r"\.ply, \.xyz, \.npz"):
        save_cloud(a_cloud(), tmp_path / "cloud.stl")


@pytest.mark.whole
def test_a_mesh_file_without_faces_is_refused(tmp_path: Path) -> None:
    save_cloud(a_cloud(), tmp_path / "cloud.ply")
    with pytest.raises(DataError, match=r"cloud\.ply"):
        load_mesh(tmp_path / "cloud.ply")
    (tmp_path / "noise.stl").write_bytes(b"noise")
    with pytest.raises(DataError, match=r"noise\.stl"):
        load_mesh(tmp_path / "noise.stl")


@pytest.mark.whole_after(1)
@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_meshes_are_read_by_suffix(tmp_path: Path, suffix: str) -> None:
    box = trimesh.creation.box((2.0, 3.0, 4.0))
    box.export(tmp_path / f"box.{suffix}")
    assert load_mesh(tmp_path / f"box.{suffix}").volume == pytest.approx(24.0)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"normals": np.zeros((N + 1, 3), np.float32)}, "normals"),
        ({"points": np.zeros((0, 3), np.float32)}, "pixels"),
        ({"points": np.full((N, 3), np.nan, np.float32)}, "finite"),
        ({"size": None}, "size"),
        ({"size": (10, 10)}, "outside"),
        ({"pixels": np.full((N, 2), -1, np.int32)}, "outside"),
    ],
)
def test_parts_that_do_not_fit_are_refused(changes: dict[str, object], word: str) -> None:
    with pytest.raises(DataError, match=word):
        a_cloud(**changes)


def test_a_surface_needs_pixels_and_a_window_an_odd_width() -> None:
    with pytest.raises(DataError, match="camera pixel"):
        Cloud(a_cloud().points).grid_mesh()
    with pytest.raises(ConfigError, match="odd"):
        local_quadric_distance(a_cloud(), window=4)


def test_a_selection_of_another_number_of_points_is_refused() -> None:
    cloud = a_cloud()
    with pytest.raises(DataError, match=r"a selection of \(\d+,\) does not fit"):
        cloud.only(np.ones(len(cloud) + 1, np.bool_))
